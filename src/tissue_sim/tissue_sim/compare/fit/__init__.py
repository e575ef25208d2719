"""Identification: the parameters with which a model comes closest to a reference."""
