"""The thesis' comparison of models on the wall, done again (THESIS.md, sections 6 and 7)."""
