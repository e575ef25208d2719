"""What becomes of a recording when people take over its tools: recorded and live inputs in one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

from tissue_sim.frame import Answer, Command, Frame, FrameInputs, JournalEntry, ToolSample
from tissue_sim.geometry.edit import REDO, UNDO, TopologyEdit
from tissue_sim.journal import START
from tissue_sim.requests import Request
from tissue_sim.simulation import Simulation


@dataclass
class Branch:
    """A session that began as a recording and goes on with what people do.

    A tool that was taken over follows the recording until its person's first own input; the others
    follow it on. As long as nobody has done anything the frames are those of the recording, bit for
    bit. Afterwards what the recording says of the tissue may no longer fit: an edit counts only if
    it was planned on a version that both have in common and what it has read is as it was; undo,
    redo and releases by number count only as long as they mean the same.

    Attributes:
        id: Its name: the epoch it goes on in.
        frame: The last frame, of that epoch, before the first tool was taken over.
        taken: Tools that people have taken over.
        own: Tools that people move.
        parted: Whether somebody has done something.
        common_version: The newest version of the mesh that is that of the recording too.
        common_hold: The greatest id of a hold that is that of the recording too.
    """

    id: str
    frame: int
    taken: set[str] = field(default_factory=set)
    own: set[str] = field(default_factory=set)
    parted: bool = False
    common_version: int = 0
    common_hold: int = 0
    _same_topology: bool = True
    _notes: list[str] = field(default_factory=list)
    _last: tuple[ToolSample, ...] = ()

    def hand_over(self, tool: str) -> bool:
        """Whether a person's input to a tool counts; the first one makes the tool theirs."""
        if tool in self.taken and tool not in self.own:
            self.own.add(tool)
            self.parted = True
            self._notes.append(f"{tool} no longer follows the recording")
        return tool in self.own

    def merge(
        self,
        entry: JournalEntry | None,
        live: FrameInputs,
        asked: Sequence[Request],
        simulation: Simulation,
    ) -> tuple[FrameInputs, list[Request]]:
        """What takes effect in the next frame, the recorded before the live.

        Args:
            entry: The recorded frame; None: the recording is over, and its tools stay where they
                are.
            live: What people do; samples of their own tools only.
            asked: Who asked for the commands, then for the edits of it.
            simulation: What it takes effect in.

        Returns:
            The inputs, and who is to be told what became of its commands, then of its edits.
        """
        self._remember(simulation)
        commands: list[Command] = []
        edits: list[TopologyEdit] = []
        if entry is not None:
            self._last = entry.inputs.tools
            commands = [c for c in entry.inputs.commands if self._counts(c, simulation)]
            edits = [edit for edit in entry.inputs.edits if self._fits(edit)]
        changes = (UNDO, REDO)
        self._same_topology &= not (live.edits or any(c.kind in changes for c in live.commands))
        self.parted |= bool(live.commands or live.edits)
        tools = _merged(self._last, {sample.tool: sample for sample in live.tools})
        if entry is None:
            recorded = {sample.tool for sample in self._last} - self.own
            tools = [replace(s, edge=0) if s.tool in recorded else s for s in tools]
        count = len(live.commands)
        answers = [
            *(Request(command.kind) for command in commands), *asked[:count],
            *(self._recorded_edit(edit) for edit in edits), *asked[count:],
        ]  # fmt: skip
        inputs = FrameInputs((*commands, *live.commands), (*edits, *live.edits), tuple(tools))
        return inputs, answers

    def finish(self, frame: Frame) -> Frame:
        """The frame as others may see it, with what was left out said.

        Cuts that the recording has the edits of are not asked for again.
        """
        notes, self._notes = tuple(self._notes), []
        cuts = tuple(cut for cut in frame.cuts if cut.tool in self.own)
        return replace(frame, cuts=cuts, events=(*notes, *frame.events))

    def _remember(self, simulation: Simulation) -> None:
        if self._same_topology:
            self.common_version = simulation.mesh.version
        if not self.parted:
            self.common_hold = max([self.common_hold, *simulation.holds.by_id])

    def _counts(self, command: Command, simulation: Simulation) -> bool:
        """Whether a recorded command still means what it meant."""
        kind, arguments = command.kind, command.arguments
        if kind == START or not self.parted:
            return kind != START
        tool = str(arguments.get("tool", arguments.get("id", "")))
        hold = int(arguments.get("hold_id", 0))
        held = simulation.holds.by_id.get(hold)
        if tool in self.own or (held is not None and held.tool in self.own):
            return False
        if (kind in (UNDO, REDO) and not self._same_topology) or hold > self.common_hold:
            self._notes.append(f"the recorded {kind} is left out: it would mean something else")
            return False
        return True

    def _fits(self, edit: TopologyEdit) -> bool:
        """Whether a recorded edit can still be tried."""
        if {edit.author, edit.held_by} & self.own:
            self._leave_out(edit, f"{edit.author or edit.held_by} is a person's")
            return False
        if not self._same_topology and edit.base_version > self.common_version:
            self._leave_out(edit, "the tissue it was made for is not there")
            return False
        return True

    def _recorded_edit(self, edit: TopologyEdit) -> Request:
        def done(answer: Answer) -> None:
            if not answer.success:
                self._leave_out(edit, answer.message)

        return Request("edit", {}, edit.request_id, done)

    def _leave_out(self, edit: TopologyEdit, why: str) -> None:
        self._same_topology = False
        author = f" by {edit.author}" if edit.author else ""
        self._notes.append(f"the recorded {edit.kind}{author} is left out: {why}")


def _merged(recorded: Iterable[ToolSample], live: dict[str, ToolSample]) -> list[ToolSample]:
    """Samples in the recorded order, those of people in place of the recorded ones."""
    tools = [live.pop(sample.tool, sample) for sample in recorded]
    return [*tools, *live.values()]
