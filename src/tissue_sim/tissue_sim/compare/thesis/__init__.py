"""The founding thesis' comparison of models on the wall, repeated."""
