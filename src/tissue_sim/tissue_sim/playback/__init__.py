"""Recorded sessions that are played, and taken over by people."""
