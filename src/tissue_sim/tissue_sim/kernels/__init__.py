"""Numba loops, grouped by what they loop over."""
