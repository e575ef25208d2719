"""What goes wrong with meshes, said so that a person can act on it."""

from __future__ import annotations


class MeshError(ValueError):
    """A mesh that cannot be simulated; the message names the file, the element and the reason."""


class MeshFileError(MeshError):
    """A file that is not a usable mesh; the message names file, place in it and reason."""
