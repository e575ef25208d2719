"""A session in one process, told as the messages that its node would publish."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from tissue_interfaces.msg import HeldNodes, TissueState, Tool, ToolList

from support.small_block import CORNER, block_simulation, pose_of, tool_at
from tissue_sim import conversions, edit_messages, journal_messages
from tissue_sim.condition_topics import material_to_msg
from tissue_sim.frame import Budget, Command, FrameInputs, ToolSample
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.simulation import Simulation

Take = Callable[[str, Any], None]
PERIOD = 16_666_667


class ToldSession:
    """A block whose corner a grasper pulls.

    Attributes:
        simulation: The session.
        shapes: Positions of every frame so far, by its number.
    """

    def __init__(self, model: str, steps: int | None = 3, **parameters: float) -> None:
        """Stand before the first frame.

        Args:
            model: Its model.
            steps: Steps in a frame; None: as the time step of a dynamic model asks.
            parameters: Parameters of the model.
        """
        self.simulation: Simulation = block_simulation(
            tool_at(CORNER), model=model, parameters={model: parameters}
        )
        self.shapes: dict[int, np.ndarray] = {}
        self._steps = steps
        self._listeners: list[Take] = []
        self._pressed = False

    def listen(self, take: Take) -> None:
        """Somebody joins: it gets what is latched, then all that comes."""
        simulation, stamp = self.simulation, conversions.stamp_of(0)
        epoch = simulation.epoch
        take(
            "tissue/topology", conversions.mesh_to_topology(simulation.mesh, epoch, "organ", stamp)
        )
        tools = ToolList(tools=[self._tool(tool) for tool in simulation.tools.values()])
        take("tissue/tools", tools)
        take("tissue/material", material_to_msg(simulation.scene.material, epoch))
        take("tissue/held_nodes", self._held())
        self._listeners.append(take)

    def frame(
        self, at: Any, use: bool, *edits: TopologyEdit, commands: tuple[Command, ...] = ()
    ) -> None:
        """One frame with the grasper somewhere, pressed or not; everybody is told."""
        edge = int(use) - int(self._pressed)
        self._pressed = use
        sample = ToolSample("grasper", pose_of(at), 0, use, edge)  # type: ignore[arg-type]
        inputs = FrameInputs(commands, tuple(edits), (sample,))
        made = self.simulation.advance(inputs, Budget(steps=self._steps))
        entry, epoch = made.journal, self.simulation.epoch
        self.shapes[entry.frame] = made.positions.copy()
        stamp = conversions.stamp_of(entry.frame * PERIOD)
        state = TissueState(
            header=conversions.header("organ", stamp), version=entry.version, frame=entry.frame
        )
        state.epoch = conversions.epoch_field(epoch)
        conversions.fill_state(state, made.positions)
        applied = [
            edit_messages.edit_to_msg(edit.change.edit, epoch, "organ", stamp)
            for edit in made.edits
        ]
        whole = [edit_messages.edit_to_msg(e, epoch, "organ", stamp) for e in entry.inputs.edits]
        told = [("tissue/edits", edit) for edit in applied]
        told.append(("tissue/journal", journal_messages.entry_to_msg(entry, whole, "organ", stamp)))
        told += [("tissue/held_nodes", self._held()), ("tissue/state", state)]
        for take in self._listeners:
            for topic, message in told:
                take(topic, message)

    def pull(self, frames: int, far: float = 0.02, start: int = 0) -> None:
        """Press in the first of some frames and move outward."""
        for number in range(frames):
            self.frame(CORNER + far * np.array([0.0, (start + number) / frames, 0.0]), True)

    def _held(self) -> HeldNodes:
        simulation = self.simulation
        held = HeldNodes(version=simulation.mesh.version)
        held.epoch = conversions.epoch_field(simulation.epoch)
        conversions.fill(held.nodes, simulation.mesh.node_ids[simulation.holds.rows])
        return held

    @staticmethod
    def _tool(tool: Any) -> Any:
        return Tool(
            id=tool.id, kind=tool.kind, shape=tool.shape, size=list(map(float, tool.size)),
            owner=tool.owner, pose=conversions.pose_message(tool.pose),
        )  # fmt: skip
