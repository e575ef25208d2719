"""What is wrong with a mesh: mend what is safe, say what was done, refuse the rest.

See docs/geometry.md for the table of checks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissue_sim.geometry.errors import MeshError
from tissue_sim.geometry.mending import MENDERS, SURFACE_MENDERS, element_id, label, part_sizes
from tissue_sim.geometry.quality import radius_ratios, signed_volumes
from tissue_sim.geometry.raw_mesh import RawMesh

LARGEST_ORGAN = 1.5
SMALLEST_ORGAN = 2e-3
"""Sizes [m] beyond which the units are probably wrong."""


@dataclass(frozen=True)
class Report:
    """What was found in a mesh.

    Attributes:
        name: Name of the geometry.
        source: File or generator.
        node_count: Nodes, after mending.
        element_count: Tetrahedra, after mending.
        triangle_count: Surface triangles of the file, after mending.
        part_sizes: Nodes of each connected part, largest first.
        size: Extent along x, y and z [m].
        volume: Volume of the tetrahedra [m^3]; 0 for a surface.
        quality_min: Least of q = 3 x inscribed / circumscribed radius; 0 for a surface.
        quality_median: Median of q.
        mended: What was mended, one sentence each.
        warnings: What looks wrong but was left, one sentence each.
        refused: Why the mesh cannot be used; "" if it can.
    """

    name: str
    source: str
    node_count: int
    element_count: int
    triangle_count: int
    part_sizes: tuple[int, ...]
    size: tuple[float, float, float]
    volume: float
    quality_min: float
    quality_median: float
    mended: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    refused: str = ""

    def lines(self) -> list[str]:
        """The report for people, one line per finding."""
        size = " x ".join(f"{1e3 * s:.4g}" for s in self.size)
        text = f"{self.node_count} nodes, {self.element_count} tetrahedra"
        if not self.element_count:
            text = f"{self.node_count} nodes, {self.triangle_count} triangles"
        lines = [f"{self.name}: {text}, {size} mm, {len(self.part_sizes)} part(s)"]
        if self.element_count:
            lines.append(
                f"volume {1e6 * self.volume:.4g} ml, quality q min {self.quality_min:.3g}, "
                f"median {self.quality_median:.3g}"
            )
        lines += [f"mended: {text}" for text in self.mended]
        lines += [f"warning: {text}" for text in self.warnings]
        return lines + ([f"refused: {self.refused}"] if self.refused else [])


def mend(raw: RawMesh) -> tuple[RawMesh, Report]:
    """Check a mesh and mend what is safe to mend.

    Args:
        raw: Tetrahedra, or a surface only.

    Returns:
        A mesh that is safe to simulate (or a surface that is safe to fill), and what was done.

    Raises:
        MeshError: It cannot be mended; the message names source, element and reason.
    """
    mended: list[str] = []
    raw = _mend_into(raw, mended)
    return raw, _report(raw, tuple(mended))


def inspect(raw: RawMesh) -> Report:
    """Find out what `mend` would do to a mesh, without raising."""
    mended: list[str] = []
    try:
        raw = _mend_into(raw, mended)
    except MeshError as error:
        return _report(raw, tuple(mended), refused=str(error))
    return _report(raw, tuple(mended))


def _mend_into(raw: RawMesh, mended: list[str]) -> RawMesh:
    for step in MENDERS if len(raw.tetrahedra) else SURFACE_MENDERS:
        raw = step(raw, mended)
    if not len(raw.tetrahedra) and not len(raw.triangles):
        raise MeshError(f"{label(raw)}: nothing is left after mending: {'; '.join(mended)}")
    return raw


def _report(raw: RawMesh, mended: tuple[str, ...], refused: str = "") -> Report:
    finite = raw.points[np.isfinite(raw.points).all(axis=1)]
    size = np.ptp(finite, axis=0) if len(finite) else np.zeros(3)
    volume, quality = 0.0, np.zeros(1)
    warnings: list[str] = []
    parts: tuple[int, ...] = ()
    if not refused:
        parts = part_sizes(raw)
        if len(raw.tetrahedra):
            volume = float(signed_volumes(raw.points, raw.tetrahedra).sum())
            quality = radius_ratios(raw.points, raw.tetrahedra)
            if quality.min() < 0.01:
                worst = int(np.argmin(quality))
                warnings.append(
                    f"{int((quality < 0.01).sum())} nearly flat elements (q below 0.01), the worst "
                    f"is element {element_id(raw, worst)} with q = {quality[worst]:.2g}"
                )
    warnings += _odd_size(float(size.max()))
    if len(parts) > 1:
        warnings.append(f"{len(parts)} separate parts of {', '.join(map(str, parts[:5]))} nodes")
    return Report(
        name=raw.name,
        source=raw.source,
        node_count=len(raw.points),
        element_count=len(raw.tetrahedra),
        triangle_count=len(raw.triangles),
        part_sizes=parts,
        size=(float(size[0]), float(size[1]), float(size[2])),
        volume=volume,
        quality_min=float(quality.min()),
        quality_median=float(np.median(quality)),
        mended=mended,
        warnings=tuple(warnings),
        refused=refused,
    )


def _odd_size(largest: float) -> list[str]:
    if largest > LARGEST_ORGAN:
        return [f"it is {largest:.3g} m large; did you mean --units mm?"]
    if largest < SMALLEST_ORGAN:
        return [f"it is {1e3 * largest:.3g} mm large; did you mean --units m?"]
    return []
