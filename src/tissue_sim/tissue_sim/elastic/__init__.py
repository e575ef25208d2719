"""How the organ deforms: one file per model behind one small protocol."""
