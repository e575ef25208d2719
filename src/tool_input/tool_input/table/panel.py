"""What everybody can do beside dragging: take back, let go, pause, begin anew."""

from __future__ import annotations

import viser
from std_srvs.srv import SetBool, Trigger
from tissue_interfaces.msg import Status
from tissue_interfaces.srv import Undo

from tissue_sim.geometry.edit import REDO, UNDO, TopologyEdit
from tissue_sim.undo_client import stroke_of
from tool_input.table.commands import Command, add_commands
from tool_input.table.edit_stack import made_by, next_edits
from tool_input.table.person import Person


class Panel:
    """The buttons of one person, and their keys.

    Attributes:
        commands: What they do, for the help panel.
    """

    def __init__(self, person: Person, gui: viser.GuiApi) -> None:
        """Add them to a window.

        Args:
            person: Whose window it is.
            gui: The window's controls.
        """
        self._person = person
        self._gui = gui
        self._foreign: int | None = None
        self.commands = (
            Command("Undo", "Takes back the newest edit of the tissue.", self._undo,
                    "Z", "cmd/ctrl"),
            Command("Redo", "Makes it again.", self._redo, "Z", "cmd/ctrl+shift"),
            Command("Let go", "Your tools release all they hold.", self._release, "R"),
            Command("Pause", "Stops time for everybody, and lets it go on.", self._pause, "P"),
            Command("Reset", "Puts the organ back to its start, for everybody.", self._ask_reset),
        )  # fmt: skip
        add_commands(gui, person, "Session", self.commands)

    def _undo(self) -> None:
        self._revert(UNDO)

    def _redo(self) -> None:
        self._revert(REDO)

    def _revert(self, what: str) -> None:
        """Undo or redo; what somebody else did only when asked a second time."""
        mesh = self._person.desk.replica.mesh
        following = next_edits(change.edit for change in mesh.changes) if mesh is not None else None
        edit = None
        if following is not None:
            edit = following.to_undo if what == UNDO else following.to_redo
        if edit is not None and not self._is_mine(edit) and self._foreign != edit.version:
            self._foreign = edit.version
            by = edit.author or "somebody else"
            self._person.tell(
                f"The edit that {what} would take is a {edit.kind} by {by}. To {what} it "
                f"nevertheless, press {what.capitalize()} again."
            )
            return
        self._foreign = None
        self._ask_revert(what, "edit" if edit is None else edit.kind)

    def _ask_revert(self, what: str, kind: str) -> None:
        def answered(answer: Undo.Response) -> None:
            stroke = stroke_of(answer.reverted_request_id)
            if stroke and stroke == stroke_of(answer.next_request_id):
                self._ask_revert(what, kind)
                return
            left = answer.can_undo if what == UNDO else answer.can_redo
            done = "Undone" if what == UNDO else "Done again"
            self._person.tell(f"{done}: {kind}. {left} more to {what}.")

        self._person.request(what, Undo.Request(), answered)

    def _is_mine(self, edit: TopologyEdit) -> bool:
        person = self._person
        return made_by(edit.author, edit.request_id, person.name, person.tool_prefix)

    def _release(self) -> None:
        self._person.tools.release()

    def _pause(self) -> None:
        status = self._person.desk.status
        paused = status is not None and status.state == Status.PAUSED
        self._person.request("pause", SetBool.Request(data=not paused))

    def _ask_reset(self) -> None:
        """Reset once more asked: it takes everybody's work away."""
        modal = self._gui.add_modal("Put the organ back to its start?")
        with modal:
            self._gui.add_markdown("Cuts, stitches and patches of everybody are lost.")
            reset, keep = self._gui.add_button("Reset"), self._gui.add_button("Keep on")

        def answer(confirmed: bool) -> None:
            modal.close()
            if confirmed:
                self._person.request("reset", Trigger.Request())

        reset.on_click(self._person.in_turn(lambda: answer(True)))
        keep.on_click(self._person.in_turn(lambda: answer(False)))
