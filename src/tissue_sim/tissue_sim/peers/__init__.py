"""Other simulators given the same tissue, for comparison; none of them is imported before use."""
