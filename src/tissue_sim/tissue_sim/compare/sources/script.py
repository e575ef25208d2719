"""An interaction out of a procedure (docs/tool_input.md), played in one process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from cut_service.stage import Stage, StageError
from tissue_sim.compare.interaction import InteractionError
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.sources.held_frames import HeldFrames
from tissue_sim.compare.sources.played import (
    STEPS,
    frame_note,
    grasper,
    session_hz,
    stage_of,
    tools_beside,
)
from tissue_sim.compare.sources.recorded import Recording
from tissue_sim.interaction.tools import GRAB, ToolSpec
from tool_input.player import Player
from tool_input.procedure import Event, Procedure, ProcedureTool, load_procedure

KEEPS_THE_MESH = ("label", "press", "release", "grab", "let_go", "model", "pause", "closure")
"""Actions that change no topology; before any other one the interaction ends."""

LEFT_OUT = ("model", "closure")
"""Actions that say nothing of what is held."""


def interaction_of_script(
    path: Path,
    organ: Organ,
    rate_hz: float = 30.0,
    tools: Mapping[str, ToolSpec] | None = None,
) -> Recording:
    """What a procedure does to an organ, up to its first change of the mesh.

    Where tissue is when it is grabbed is decided by linear finite elements, close to equilibrium in
    every frame.

    Args:
        path: The procedure.
        organ: The organ; not changed.
        rate_hz: Frames per second [1/s].
        tools: Tools that there are, by name; None: those of the project's scene with the organ's
            name. A grab that neither they nor the procedure give a size holds some 60 nodes.

    Raises:
        ValueError: The procedure cannot be played, or holds nothing.
    """
    procedure = load_procedure(path)
    known = tools_beside(organ) if tools is None else tools
    there, notes = _tools(procedure, organ, known)
    notes += frame_note([procedure.frame_id])
    end = next((event for event in procedure.events if _changes(procedure, event)), None)
    if end is not None:
        notes += (f"{end.where}: {end} changes the mesh; the interaction ends before it",)
        procedure = _until(procedure, end.time)
    frames = _played(procedure, Stage(*stage_of(organ, there, rate_hz), STEPS))
    interaction, _ = frames.interaction(path.stem, organ, session_hz(rate_hz), rate_hz)
    return Recording(organ, interaction, None, (*notes, *frames.notes()))


def _changes(procedure: Procedure, event: Event) -> bool:
    """Whether an event cuts, burns, sews, patches or brings back what was."""
    if event.action == "press":
        return procedure.tools[event.target].kind != GRAB
    return event.action not in KEEPS_THE_MESH


def _until(procedure: Procedure, end: float) -> Procedure:
    """What comes before a time [s]."""
    events = [event for event in procedure.events if event.time < end]
    return replace(procedure, events=events, end=end)


def _played(procedure: Procedure, stage: Stage) -> HeldFrames:
    events = [event for event in procedure.events if event.action not in LEFT_OUT]
    player, frames = Player(replace(procedure, events=events), stage), HeldFrames()
    try:
        stage.play(player, lambda _: frames.take(stage.simulation))
    except StageError as error:
        raise InteractionError(str(error)) from error
    return frames


def _tools(
    procedure: Procedure, organ: Organ, known: Mapping[str, ToolSpec]
) -> tuple[list[ToolSpec], tuple[str, ...]]:
    """The graspers of a procedure, and which of them had no size."""
    tools: list[ToolSpec] = []
    notes: tuple[str, ...] = ()
    for name, tool in procedure.tools.items():
        there = known.get(name)
        if there is not None and there.kind != tool.kind:
            raise InteractionError(
                f"tool {name} is a {there.kind} tool of {organ.name}, not a {tool.kind} tool"
            )
        if tool.kind != GRAB:
            continue
        if there is None and not tool.size:
            there = grasper(name, organ)
            notes += (f"{name} has no size: a radius of {1e3 * there.size[0]:.3g} mm is taken",)
        tools.append(_placed(tool, there or ToolSpec(name)))
    return tools, notes


def _placed(tool: ProcedureTool, there: ToolSpec) -> ToolSpec:
    """A tool as the procedure wants it, where it begins."""
    pose = (*tool.start.position.tolist(), *tool.start.quaternion.tolist())
    return replace(
        there, shape=tool.shape or there.shape, size=tool.size or there.size, pose=pose
    ).checked()
