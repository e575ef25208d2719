"""What the tissue tells: stress, strain and displacement at its nodes, and tissue to spare."""
