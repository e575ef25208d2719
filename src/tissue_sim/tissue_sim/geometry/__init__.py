"""What the organ is: meshes, their formats, generated shapes and versioned edits."""
