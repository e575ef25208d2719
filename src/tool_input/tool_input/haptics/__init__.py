"""Forces for a hand between the frames of the simulation."""
