"""Plans cuts through the tissue as topology edits, in a process of its own."""
