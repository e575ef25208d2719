"""Shows and records the simulation: rerun viewer and recordings, MCAP bags."""
