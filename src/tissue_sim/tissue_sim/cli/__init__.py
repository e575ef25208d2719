"""The `tissue` command."""

from tissue_sim.cli.main import main

__all__ = ["main"]
