"""Tools that cut as they move: their strokes, and what the tissue does to them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue_sim.frame import Cut, ToolSample
from tissue_sim.interaction import rigid
from tissue_sim.interaction.blade_contact import mean_edge, sides_in_tissue, touched_nodes
from tissue_sim.interaction.cut_response import resistance
from tissue_sim.interaction.holds import Hold
from tissue_sim.interaction.strokes import FARTHEST, STEP_SHARE, Stroke
from tissue_sim.interaction.tools import PROGRESSIVE, ToolSpec, blade, outline

if TYPE_CHECKING:
    from tissue_sim.simulation import Simulation

TOUCH = 0.5
"""A blade touches what is within this share of the tissue's mean edge."""

FELT = 0.75
"""Part of a blade is in tissue if a node is within this share of the mean edge."""

_NO_VERTICES = np.empty((0, 3))
_NO_TRIANGLES = np.empty((0, 3), dtype=np.uint32)


class ProgressiveCuts:
    """The strokes of a simulation's tools; part of `Simulation.advance`.

    A stroke begins where its tool is pressed, with the blade itself, and goes on with the strips
    that the blade's sides pass. With a puncture force the blade at first holds the nodes that it
    touches by force; what it has passed meanwhile is cut when the tissue opens.

    Attributes:
        strokes: By tool.
        wrenches: Force [N] and torque about the tip [N m] of what is being cut on each tool, shape
            (6,) each.
        events: What happened, in words; whoever reads them clears them.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.strokes: dict[str, Stroke] = {}
        self.wrenches: dict[str, NDArray[np.float64]] = {}
        self.events: list[str] = []
        self._simulation = simulation
        self._edge = mean_edge(simulation.mesh)
        self._pushed: dict[str, tuple[Hold, NDArray[np.float64], float]] = {}
        self._over: list[Cut] = []

    def taken_over(self) -> list[Cut]:
        """The last cuts of strokes that ended because their tool was changed or removed."""
        over, self._over = self._over, []
        return over

    def forget(self, tool: str) -> None:
        """End the stroke of a tool that is no longer what it was."""
        stroke = self.strokes.pop(tool, None)
        self.wrenches.pop(tool, None)
        if self._pushed.pop(tool, None):
            self._simulation.release([h for h in self._simulation.holds.of_tool(tool) if h.by_use])
        if stroke is not None and stroke.count:
            nothing = (_NO_VERTICES, _NO_TRIANGLES)
            self._over.append(Cut(tool, 0, *nothing, stroke.id, stroke.count, True))

    def use(self, tool: ToolSpec, sample: ToolSample) -> list[Cut]:
        """What a tool cuts in this frame.

        Args:
            tool: A cutting tool.
            sample: As it is used.
        """
        self.wrenches.pop(tool.id, None)
        stroke = self.strokes.get(tool.id)
        if stroke is None:
            if sample.edge != 1 or tool.cutting != PROGRESSIVE:
                return []
            return self._begin(tool, sample)
        if way := stroke.jumped(sample.pose):
            self.events.append(
                f"{tool.id} jumped {way:.4g} m while cutting; farther than {FARTHEST:g} m in a "
                "frame it does not cut: the stroke goes on from where it is"
            )
            self._let_go(tool.id)
            stroke.restart(sample.pose)
        if not stroke.cutting:
            return self._push(tool, stroke, sample)
        return self._cut(tool, stroke, sample)

    def _begin(self, tool: ToolSpec, sample: ToolSample) -> list[Cut]:
        simulation = self._simulation
        name = f"{simulation.epoch.hex()[:8]}-{simulation.frame}-{tool.id}"
        stroke = Stroke(name, outline(tool), STEP_SHARE * self._edge, sample.pose)
        self.strokes[tool.id] = stroke
        if tool.response.puncture_force > 0.0:
            stroke.cutting = False
            return self._push(tool, stroke, sample)
        return [self._next(stroke, sample, blade(tool, sample.pose))]

    def _cut(self, tool: ToolSpec, stroke: Stroke, sample: ToolSample) -> list[Cut]:
        if tool.response.resists and not sample.edge:
            self._resist(tool, stroke, sample.pose)
        over = sample.edge == -1
        strips = stroke.follow(sample.pose, last=over)
        if over:
            del self.strokes[tool.id]
            strips = strips or (_NO_VERTICES, _NO_TRIANGLES)
        return [self._next(stroke, sample, strips, over)] if strips else []

    @staticmethod
    def _next(
        stroke: Stroke,
        sample: ToolSample,
        sweep: tuple[NDArray[np.float64], NDArray[np.uint32]],
        ends: bool = False,
    ) -> Cut:
        stroke.count += 1
        return Cut(sample.tool, sample.stamp, *sweep, stroke.id, stroke.count - 1, ends)

    def _resist(self, tool: ToolSpec, stroke: Stroke, pose: NDArray[np.float64]) -> None:
        simulation, reach = self._simulation, FELT * self._edge
        rows = touched_nodes(simulation.mesh, simulation.state, stroke, pose, reach)
        places = simulation.mesh.rest[rows] + simulation.state.displacement[rows]
        lengths, middles = sides_in_tissue(places, stroke, pose, reach)
        self.wrenches[tool.id] = resistance(
            tool.response,
            rigid.to_world(stroke.pose, middles),
            rigid.to_world(pose, middles),
            stroke.outwards @ rigid.matrix(pose[3:]).T,
            lengths,
            pose[:3],
            1.0 / simulation.scene.rate_hz,
        )

    # Before the tissue opens

    def _push(self, tool: ToolSpec, stroke: Stroke, sample: ToolSample) -> list[Cut]:
        """Push what the blade touches; cut once the tissue gives way."""
        if sample.edge == -1:
            self._let_go(tool.id)
            del self.strokes[tool.id]
            return []
        pushed = self._pushed.get(tool.id)
        if pushed is not None and not self._gone(pushed[0]):
            hold, contact, farthest = pushed
            if self._gives_way(tool, stroke, hold, contact):
                self._let_go(tool.id)
                stroke.cutting = True
                stroke.restart(contact)
                return self._opened(stroke, sample, blade(tool, contact))
            way = float(np.linalg.norm(sample.pose[:3] - contact[:3]))
            stroke.pose = sample.pose.copy()
            if way >= 0.5 * farthest or farthest < stroke.step:
                self._pushed[tool.id] = (hold, contact, max(way, farthest))
                return []
            # It goes back: tissue does not stick to a blade.
            self._let_go(tool.id)
        before = stroke.pose
        stroke.restart(sample.pose)
        self._touch(tool, stroke, before, sample.pose)
        return []

    def _opened(
        self,
        stroke: Stroke,
        sample: ToolSample,
        begun: tuple[NDArray[np.float64], NDArray[np.uint32]],
    ) -> list[Cut]:
        """The blade where it touched the tissue, and all that it has passed since."""
        strips = stroke.follow(sample.pose)
        vertices, triangles = begun
        if strips is not None:
            triangles = np.concatenate([triangles, strips[1] + np.uint32(len(vertices))])
            vertices = np.concatenate([vertices, strips[0]])
        return [self._next(stroke, sample, (vertices, triangles))]

    def _touch(
        self,
        tool: ToolSpec,
        stroke: Stroke,
        before: NDArray[np.float64],
        pose: NDArray[np.float64],
    ) -> None:
        """Hold what the blade touches, if it moves into it."""
        simulation, reach = self._simulation, TOUCH * self._edge
        mesh = simulation.mesh
        rows = touched_nodes(mesh, simulation.state, stroke, pose, reach)
        rows = rows[~mesh.fixed[rows]]
        places = mesh.rest[rows] + simulation.state.displacement[rows]
        lengths, middles = sides_in_tissue(places, stroke, pose, 2.0 * reach)
        way = rigid.to_world(pose, middles) - rigid.to_world(before, middles)
        ahead = np.einsum("ij,ij->i", way @ rigid.matrix(pose[3:]), stroke.outwards)
        if (ahead[lengths > 0.0] > 0.0).any():
            hold = simulation.hold(tool.id, rows, by_use=True, by_force=True)
            self._pushed[tool.id] = (hold, pose.copy(), 0.0)

    def _gives_way(
        self, tool: ToolSpec, stroke: Stroke, hold: Hold, contact: NDArray[np.float64]
    ) -> bool:
        """Whether the last frame ended beyond what the tissue bears."""
        way = float(np.linalg.norm(stroke.pose[:3] - contact[:3]))
        if way >= tool.response.puncture_depth:
            return True
        if hold.patch is None or not self._simulation.model.has_forces:
            return False
        wrench = tool.coupling.wrench_on_tool(stroke.pose, hold.patch.pose)
        return float(np.linalg.norm(wrench[:3])) >= tool.response.puncture_force

    def _gone(self, hold: Hold) -> bool:
        return self._simulation.holds.by_id.get(hold.id) is not hold

    def _let_go(self, tool: str) -> None:
        pushed = self._pushed.pop(tool, None)
        if pushed is not None and not self._gone(pushed[0]):
            self._simulation.release([pushed[0]])
