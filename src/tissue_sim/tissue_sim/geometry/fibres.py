"""How the fibres of a tissue run: the small language of scene files.

- `` (nothing) or `none`: there are none
- `cell:NAME`: vectors of the file's cells by name (VTU or VTK cell data of three numbers)
- `along:x,y,z`: everywhere in this direction
- `around:x,y,z` or `around:x,y,z:px,py,pz`: in circles about an axis of this direction, through the
  middle of the mesh or through the point p [m]
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.raw_mesh import RawMesh

GRAMMAR = "none, cell:NAME, along:x,y,z, around:x,y,z or around:x,y,z:px,py,pz [m]"


class FibreError(ValueError):
    """A direction of fibres that is not there or that is not understood."""


def fibres_of(raw: RawMesh, text: str) -> NDArray[np.float32]:
    """Unit vector along the fibres of each tetrahedron, shape (element_count, 3); zero: none.

    Args:
        raw: The mesh.
        text: How they run.

    Raises:
        FibreError: It is not understood, or the mesh has no such vectors.
    """
    kind, _, rest = text.strip().partition(":")
    count = len(raw.tetrahedra)
    if kind in ("", "none") and not rest:
        return np.zeros((count, 3), dtype=np.float32)
    if kind == "cell":
        return unit_fibres(_of_cells(raw, rest), count)
    if kind == "along":
        return unit_fibres(np.tile(_direction(text, rest), (count, 1)), count)
    if kind == "around":
        direction, _, point = rest.partition(":")
        middle = 0.5 * (raw.points.min(axis=0) + raw.points.max(axis=0))
        through = _vector(text, point) if point else middle
        arms = raw.points[raw.tetrahedra].mean(axis=1) - through
        return unit_fibres(np.cross(_direction(text, direction), arms), count)
    raise FibreError(f"fibres: {text!r} is not understood; allowed: {GRAMMAR}")


def unit_fibres(vectors: NDArray[np.floating], count: int) -> NDArray[np.float32]:
    """Vectors of length 1, or 0 where there is none, shape (count, 3).

    Raises:
        FibreError: They are not finite or not one for each element.
    """
    if vectors.shape != (count, 3):
        raise FibreError(f"fibres have shape {vectors.shape}; allowed: ({count}, 3), one a cell")
    bad = np.flatnonzero(~np.isfinite(vectors).all(axis=1))
    if len(bad):
        raise FibreError(
            f"fibres of {len(bad)} elements are not finite, the first is element row {bad[0]}; "
            "allowed: finite numbers, and zeros where there are no fibres"
        )
    lengths = np.linalg.norm(vectors, axis=1)
    none = lengths <= 1e-12 * lengths.max(initial=0.0)
    lengths[none] = np.inf
    return (vectors / lengths[:, None]).astype(np.float32)


def _of_cells(raw: RawMesh, name: str) -> NDArray[np.float64]:
    if name not in raw.element_vectors:
        known = ", ".join(sorted(raw.element_vectors)) or "none"
        raise FibreError(f"fibres: {raw.name} has no cell vectors {name!r}; its vectors: {known}")
    return raw.element_vectors[name]


def _direction(text: str, words: str) -> NDArray[np.float64]:
    direction = _vector(text, words)
    length = float(np.linalg.norm(direction))
    if not length > 0.0:
        raise FibreError(f"fibres: {text!r} has no direction; allowed: {GRAMMAR}")
    return direction / length


def _vector(text: str, words: str) -> NDArray[np.float64]:
    try:
        vector = np.array([float(word) for word in words.split(",")])
    except ValueError:
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise FibreError(f"fibres: {text!r} is not understood; allowed: {GRAMMAR}")
    return vector
