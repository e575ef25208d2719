"""Probes: tools that push tissue out of their way while they are in use.

Each node of the surface inside a probe is pressed out of it with the force A p(g), A being the
surface that belongs to it (`Contact`), and rubbed along it with friction: a spring as stiff as the
contact pulls it to where it first touched the probe, until that pull exceeds friction times the
normal force, when it slides (Coulomb). Nodes in contact are prescribed for the model, and before
each of its steps they make a step of their own towards the balance of contact and tissue:

    dx = F / (k_tissue + k_contact),

both bounds from above, so that it cannot overshoot and every model that has forces can be probed.
What has no forces is put on the probe's surface.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.material_field import lame_constants
from tissue_sim.elastic.model import Model, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction import rigid
from tissue_sim.interaction.reach import capsule_of
from tissue_sim.interaction.reaction import NOTHING
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.kernels.contact import Capsule, gaps, nodes_near_axis, surface_at

LEAVES = 0.1
"""Share of its radius by which a node must be off a probe to be free again: no flicker."""

NEAR = 0.5
"""Share of its radius within which nodes are remembered as near a probe."""

TURNS = 16
"""Frames in which every node of the organ is looked at once; those near in every frame."""

NEIGHBOURS_MOVE = 2.0
"""Nodes in contact step together: as neighbours they resist up to twice what one resists alone."""

Rows = NDArray[np.int32]
Reals = NDArray[np.float64]


def _no_rows() -> Rows:
    return np.empty(0, dtype=np.int32)


@dataclass
class Touch:
    """What one probe touches.

    Attributes:
        rows: Nodes in contact, ascending, shape (k,).
        anchors: Where each first touched the probe, in its axes [m], shape (k, 3).
        area: Surface of each [m^2], shape (k,).
        tissue: Bound of the tissue's stiffness at each [N/m], shape (k,).
        gap: Gap of each before the frame, with the probe where it was then [m], at most 0,
            shape (k,): the penetration's rate contains the motion of both.
        force: Force of the probe on each [N], shape (k, 3).
        near: Nodes that are looked at in every frame.
        pose: Of the probe in the frame before, shape (7,); None: there was none.
    """

    rows: Rows = field(default_factory=_no_rows)
    anchors: Reals = field(default_factory=lambda: np.empty((0, 3)))
    area: Reals = field(default_factory=lambda: np.empty(0))
    tissue: Reals = field(default_factory=lambda: np.empty(0))
    gap: Reals = field(default_factory=lambda: np.empty(0))
    force: Reals = field(default_factory=lambda: np.empty((0, 3)))
    near: Rows = field(default_factory=_no_rows)
    turn: int = 0
    pose: Reals | None = None


@dataclass(frozen=True)
class Pressed:
    """Nodes inside a probe.

    Attributes:
        places: Where they are [m], shape (k, 3).
        normal: Directions out of the probe, shape (k, 3).
        depth: How deep each is in it [m], shape (k,).
        slip: Way of each along the probe since its anchor [m], shape (k, 3).
        area: Surface of each [m^2], shape (k,).
    """

    places: Reals
    normal: Reals
    depth: Reals
    slip: Reals
    area: Reals


class Probes:
    """The probes in use.

    Attributes:
        touches: What each probe in use touches, by tool.
        rows: Nodes in contact with any of them, ascending.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.touches: dict[str, Touch] = {}
        self.rows = _no_rows()
        self._mesh = mesh
        self._found = np.empty(mesh.node_capacity, dtype=np.int32)

    def begin(
        self,
        tools: Iterable[tuple[ToolSpec, Reals]],
        state: State,
        model: Model,
        held: NDArray[np.bool_],
    ) -> bool:
        """Find what the probes in use touch; whether the nodes in contact are other ones now.

        Args:
            tools: Probes in use and their poses.
            state: Where the tissue is.
            model: What resists.
            held: Nodes that tools hold, shape (node_capacity,): they do not give way.
        """
        taken = held.copy()
        used = {}
        for tool, pose in tools:
            touch = self.touches.get(tool.id) or Touch()
            capsule = capsule_of(tool, pose)
            self._search(touch, capsule, state, taken)
            self._renew(touch, capsule, pose, state, model, taken)
            last = capsule if touch.pose is None else capsule_of(tool, touch.pose)
            # Outside there is no penetration whose rate could be damped.
            touch.gap = np.minimum(self._gaps(touch.rows, last, state)[0], 0.0)
            touch.pose = pose.copy()
            taken[touch.rows] = True
            used[tool.id] = touch
        self.touches = used
        before = self.rows
        self.rows = np.sort(
            np.concatenate([_no_rows(), *(touch.rows for touch in used.values())])
        ).astype(np.int32)
        return not np.array_equal(before, self.rows)

    def forget(self) -> None:
        """The tissue is another one, or somewhere else: find all contacts anew."""
        self.touches.clear()

    def advance(
        self, tools: Iterable[tuple[ToolSpec, Reals]], state: State, model: Model, period: float
    ) -> None:
        """One step of the nodes in contact. Modifies the state in place.

        Args:
            tools: Probes in use and their poses.
            state: Where the tissue is.
            model: What resists.
            period: Time of a frame [s].
        """
        for tool, pose in tools:
            touch = self.touches.get(tool.id)
            if touch is None or not len(touch.rows):
                continue
            gap, normal = self._gaps(touch.rows, capsule_of(tool, pose), state)
            if not model.has_forces:
                out = np.minimum(gap, 0.0)[:, None] * normal
                state.displacement[touch.rows] -= out.astype(state.displacement.dtype)
                continue
            contact = tool.contact
            pressing = self._press(touch, tool, pose, state, gap, normal, period)
            stiffness = NEIGHBOURS_MOVE * touch.tissue + np.where(
                pressing,
                touch.area
                * (contact.contact_stiffness + contact.contact_damping / period),
                0.0,
            )  # fmt: skip
            total = model.forces(state, touch.rows) + touch.force
            step = total / np.maximum(stiffness, 1e-12)[:, None]
            state.displacement[touch.rows] += step.astype(state.displacement.dtype)

    def wrench(self, tool: str, pose: Reals, state: State) -> Reals:
        """Force [N] and torque about the tip [N m] of the tissue on a probe, shape (6,)."""
        touch = self.touches.get(tool)
        if touch is None or not len(touch.rows):
            return NOTHING.copy()
        places = self._mesh.rest[touch.rows] + state.displacement[touch.rows]
        torque = np.cross(places - pose[:3], -touch.force).sum(axis=0)
        return np.concatenate([-touch.force.sum(axis=0), torque])

    def pressed(self, tool: ToolSpec, pose: Reals, state: State) -> Pressed:
        """Where and how far the tissue is pressed by a probe as things are."""
        touch = self.touches.get(tool.id) or Touch()
        gap, normal = self._gaps(touch.rows, capsule_of(tool, pose), state)
        places, slip = self._slip(touch, pose, state, normal)
        inside = gap < 0.0
        return Pressed(
            places[inside], normal[inside], -gap[inside], slip[inside], touch.area[inside]
        )

    def _slip(self, touch: Touch, pose: Reals, state: State, normal: Reals) -> tuple[Reals, Reals]:
        """Places of the nodes in contact, and how far each is along the probe from its anchor."""
        places = self._mesh.rest[touch.rows] + state.displacement[touch.rows]
        slip = places - rigid.to_world(pose, touch.anchors)
        return places, slip - np.einsum("ij,ij->i", slip, normal)[:, None] * normal

    def _search(
        self, touch: Touch, capsule: Capsule, state: State, taken: NDArray[np.bool_]
    ) -> None:
        """Look at the nodes near the probe, and at a part of the others; all after a jump."""
        mesh = self._mesh
        if len(self._found) < mesh.node_capacity:
            self._found = np.empty(mesh.node_capacity, dtype=np.int32)
        tip, radius = capsule.tip, capsule.radius
        jumped = touch.pose is None or np.linalg.norm(tip - touch.pose[:3]) > NEAR * radius
        rows = mesh.node_rows
        first = 0 if jumped else rows * touch.turn // TURNS
        last = rows if jumped else rows * (touch.turn + 1) // TURNS
        touch.turn = (touch.turn + 1) % TURNS
        part = np.arange(first, last, dtype=np.int32)
        looked = part if jumped else np.union1d(touch.near, part).astype(np.int32)
        looked = looked[mesh.node_alive[looked] & ~taken[looked] & ~mesh.fixed[looked]]
        touch.near = self._within(looked, capsule, state, (1.0 + NEAR) * radius)

    def _within(self, rows: Rows, capsule: Capsule, state: State, reach: float) -> Rows:
        count = nodes_near_axis(
            rows, self._mesh.rest, state.displacement, capsule, reach, self._found
        )
        return self._found[:count].copy()

    def _gaps(self, rows: Rows, capsule: Capsule, state: State) -> tuple[Reals, Reals]:
        gap, normal = np.empty(len(rows)), np.empty((len(rows), 3))
        gaps(rows, self._mesh.rest, state.displacement, capsule, gap, normal)
        return gap, normal

    def _renew(
        self,
        touch: Touch,
        capsule: Capsule,
        pose: Reals,
        state: State,
        model: Model,
        taken: NDArray[np.bool_],
    ) -> None:
        """Let go of nodes that are off the probe, and take those that are inside."""
        gap, _ = self._gaps(touch.rows, capsule, state)
        stays = (gap <= LEAVES * capsule.radius) & ~taken[touch.rows]
        stays &= self._mesh.node_alive[touch.rows]
        inside = self._within(touch.near, capsule, state, capsule.radius)
        new = np.setdiff1d(inside, touch.rows[stays]).astype(np.int32)
        area, tissue = self._surface(new, model)
        outside = area > 0.0
        new, area, tissue = new[outside], area[outside], tissue[outside]
        places = self._mesh.rest[new] + state.displacement[new]
        rows = np.concatenate([touch.rows[stays], new])
        order = np.argsort(rows)
        touch.anchors = np.concatenate([touch.anchors[stays], rigid.to_local(pose, places)])[order]
        touch.area = np.concatenate([touch.area[stays], area])[order]
        touch.tissue = np.concatenate([touch.tissue[stays], tissue])[order]
        touch.rows = rows[order].astype(np.int32)
        touch.force = np.zeros((len(rows), 3))

    def _surface(self, rows: Rows, model: Model) -> tuple[Reals, Reals]:
        """Surface of nodes [m^2], and a bound of what the tissue resists at them [N/m]."""
        area, shape = np.empty(len(rows)), np.empty(len(rows))
        mesh, network = self._mesh, _network(model)
        incident = mesh.incident
        surface_at(
            rows, mesh.tets, incident.start, incident.count, incident.data, mesh.rest, area, shape
        )
        material = network.material
        lame, mu = lame_constants(material)
        stiffest = max((part.young_modulus for part in material.parts), default=1.0)
        solid = (lame + 2.0 * mu) * shape * (stiffest / material.young_modulus)
        return area, np.maximum(solid, network.node_stiffness(rows))

    def _press(
        self,
        touch: Touch,
        tool: ToolSpec,
        pose: Reals,
        state: State,
        gap: Reals,
        normal: Reals,
        period: float,
    ) -> NDArray[np.bool_]:
        """Renew the forces on the nodes; which of them are pressed."""
        contact = tool.contact
        closing = (gap - touch.gap) / period
        pressure = -contact.contact_stiffness * gap - contact.contact_damping * closing
        pressing = (gap < 0.0) & (pressure > 0.0)
        push = np.where(pressing, touch.area * pressure, 0.0)
        places, slip = self._slip(touch, pose, state, normal)
        stiffness = touch.area * contact.contact_stiffness
        pull = stiffness * np.linalg.norm(slip, axis=1)
        most = contact.contact_friction * push
        share = np.minimum(1.0, most / np.maximum(pull, 1e-300))
        touch.force = push[:, None] * normal - (share * stiffness)[:, None] * slip
        # What slides, or does not touch, takes its anchor along.
        dragged = rigid.to_local(pose, places - share[:, None] * slip)
        touch.anchors = np.where((share < 1.0)[:, None], dragged, touch.anchors)
        return pressing


def _network(model: Model) -> SpringNetwork:
    network: SpringNetwork = model.springs  # type: ignore[attr-defined]
    return network
