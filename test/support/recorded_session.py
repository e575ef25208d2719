"""A session of a small block that is pulled, cut and undone, recorded in this process."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from support.small_block import CORNER, block_mesh, pose_of, tool_at
from support.split_edit import split_at
from tissue_sim.frame import Budget, Command, Edge, FrameInputs, JournalEntry, ToolSample
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.scene import Scene
from tissue_sim.session_bag import RecordedEpoch
from tissue_sim.simulation import Simulation

FAR = (0.0, 0.06, 0.0)
TOOLS = (
    tool_at(CORNER, "left"),
    tool_at(FAR, "right", hold="force"),
    tool_at((0.03, 0.03, 0.03), "knife", kind="cut", shape="rectangle", size=(0.05, 0.05)),
)
PRESS, RELEASE, CUT, UNDO = 3, 34, 12, 26


def recorded_epoch(
    frames: int = 40,
    model: str = "lr",
    tools: Sequence[ToolSpec] = TOOLS,
    epoch: bytes = bytes(range(16)),
) -> RecordedEpoch:
    """`left` and `right` pull from `PRESS` to `RELEASE`; `knife` cuts in `CUT`, undone in `UNDO`.

    A pause lasts three frames, and a second cut comes late. The numbers of steps vary as a clock
    would make them.
    """
    random = np.random.default_rng(7)
    mesh = block_mesh()
    recorded = RecordedEpoch(epoch, copy.deepcopy(mesh), organ="block")
    simulation = Simulation(mesh, Scene(model=model, tools=tuple(tools)), epoch)
    for number in range(1, frames + 1):
        edge: Edge = 1 if number == PRESS else -1 if number == RELEASE else 0
        use = PRESS <= number < RELEASE
        way = 3e-4 * max(number - PRESS, 0)
        samples = [
            ToolSample("left", pose_of(np.add(CORNER, [way, 0, way])), number, use, edge),
            ToolSample("right", pose_of(np.add(FAR, [-way, way, 0])), number, use, edge),
            ToolSample("knife", pose_of((0.03, 0.03, 0.03)), number),
        ]
        commands, edits = [], []
        if number in (20, 23):
            commands = [Command("pause", {"on": number == 20})]
        if number == UNDO:
            commands = [Command("undo", {"author": "knife"})]
        if number in (CUT, UNDO + 4):
            plane = 0.03 if number == CUT else 0.015
            edits = [replace(split_at(mesh, plane, top=0.05), author="knife")]
        there = [sample for sample in samples if sample.tool in simulation.tools]
        inputs = FrameInputs(tuple(commands), tuple(edits), tuple(there))
        frame = simulation.advance(inputs, Budget(steps=int(random.integers(1, 4))))
        recorded.entries.append(frame.journal)
    return recorded


def as_epoch(entries: Sequence[JournalEntry], epoch: bytes) -> list[JournalEntry]:
    """The same frames as those of another epoch."""
    return [replace(entry, epoch=epoch) for entry in entries]
