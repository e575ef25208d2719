"""Where interactions come from: made on a mesh, played from a script, read from a recording."""
