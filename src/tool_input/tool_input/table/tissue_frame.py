"""What a window draws: the tissue at one frame with everything heard about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.holes import Hole
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.surface import surface_triangles


@dataclass(frozen=True, eq=False)
class Surface:
    """The outside of one version of the tissue; the same object as long as that does not change.

    Compared by identity, so that what is made of it can be kept for all windows.

    Attributes:
        nodes: Rows of the nodes on it, increasing, shape (n,).
        triangles: Rows of `nodes`, outward, shape (m, 3), uint32.
    """

    nodes: NDArray[np.int64]
    triangles: NDArray[np.uint32]

    @classmethod
    def of(cls, mesh: Mesh) -> Surface:
        """The outside of a mesh."""
        nodes, corners = np.unique(surface_triangles(mesh), return_inverse=True)
        return cls(nodes.astype(np.int64), corners.reshape(-1, 3).astype(np.uint32))


@dataclass(frozen=True)
class NodeValues:
    """A quantity of the tissue at every node.

    Attributes:
        name: Such as "von_mises_stress".
        unit: SI unit; empty for a plain number.
        values: One for each node row, nan where it has no meaning, shape (node_rows,).
    """

    name: str
    unit: str
    values: NDArray[np.float32]


@dataclass(frozen=True)
class ToolShown:
    """A tool as the simulation sees it.

    Attributes:
        id: Its name.
        kind: `Tool.GRAB`, `CUT`, `BURN`, `PATCH` or `PROBE`.
        shape: `Tool.SPHERE`, `BOX`, `CAPSULE`, `RECTANGLE` or `TRIANGLE`.
        size: What `Tool.size` says [m].
        owner: The person or node that set it.
        state: `Tool.ACTIVE`, `FROZEN` or `FREE`.
        pressed: Whether it is in use.
        pose: Position [m] and quaternion x y z w, shape (7,).
    """

    id: str
    kind: str
    shape: str
    size: tuple[float, ...]
    owner: str
    state: str
    pressed: bool
    pose: NDArray[np.float64]


@dataclass(frozen=True)
class TissueFrame:
    """The tissue at one frame.

    Attributes:
        epoch: Epoch of the simulation.
        number: Frame of the simulation.
        mesh: The mesh at this version; changed in place later, never by who draws it.
        positions: Where its nodes are [m], float32, shape (node_rows, 3).
        surface: The outside of this version.
        tools: The tools by name.
        scalar: The newest of `tissue/scalar` for this version; None: none was heard.
        difference: Distance from a second model [m], likewise from `tissue/difference`.
        holes: The holes that have a name.
        risk_rows: Rows of the nodes of risk regions, shape (n,).
    """

    epoch: bytes
    number: int
    mesh: Mesh
    positions: NDArray[np.float32]
    surface: Surface
    tools: Mapping[str, ToolShown]
    scalar: NodeValues | None = None
    difference: NodeValues | None = None
    holes: tuple[Hole, ...] = ()
    risk_rows: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @property
    def version(self) -> int:
        """Version of the topology."""
        return self.mesh.version
