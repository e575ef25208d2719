"""Sewing: single stitches across a wound, or stitches between two lines along its lips."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray
from tissue_interfaces.srv import Suture

from tool_input.table.marks import Marks
from tool_input.table.modes import END, START, Drag, Vec3
from tool_input.table.page_scene import PageScene
from tool_input.table.person import Person
from tool_input.table.tool_size import MM, in_mm

STITCH, LIPS = "one stitch", "along both lips"
POINTS = 32
"""Of each lip's line in a request."""


class SewMode:
    """Sews what a drag joins, and tightens or takes out this person's stitches."""

    name = "sew"
    key = "B"
    help = (
        "Drag from one side of a wound to the other to sew a stitch. Or choose *along both lips*, "
        "draw a line along one lip and then one along the other."
    )

    def __init__(self, person: Person, scene: PageScene) -> None:
        """Begin without a stitch."""
        self._person = person
        self._marks = Marks(scene, "/sew")
        self._way = STITCH
        self._spacing = 0.05 * scene.organ_size
        self._reach = 0.06 * scene.organ_size
        self._length = 0.0
        self._running = False
        self._line: list[Vec3] | None = None
        self._first_lip: NDArray[np.float64] | None = None
        self._sewn: list[list[int]] = []

    def drag(self, drag: Drag) -> None:
        """Sew from where the drag begins to where it ends, or take its way as a lip."""
        if drag.phase == START:
            self._line = [drag.start]
        if self._line is None:
            return
        if drag.hit is not None:
            self._line.append(drag.hit)
        if drag.phase != END:
            shown = self._line if self._way == LIPS else [drag.start, drag.point]
            self._marks.line("drawn", np.array([self._line[0], *shown]))
            return
        line, self._line = np.array(self._line), None
        self._marks.remove("drawn")
        if self._way == LIPS:
            self._take_lip(line)
        elif drag.hit is None:
            raise ValueError("a stitch ends on tissue; let go over the other side of the wound")
        else:
            self._sew(np.array([drag.start, drag.hit]), 0.0)

    def settings(self, gui: viser.GuiApi) -> None:
        """How stitches are made; and what is done with those that were."""
        step = self._reach / 60 / MM
        way = gui.add_dropdown("Drag", (STITCH, LIPS), initial_value=self._way)
        length = gui.add_slider(
            "Length [mm]", 0.0, 100 * step, step, in_mm(self._length),
            hint="Of the thread at rest; 0 draws both sides together",
        )  # fmt: skip
        spacing = gui.add_slider("Spacing [mm]", step, 100 * step, step, in_mm(self._spacing))
        reach = gui.add_slider(
            "Bite [mm]", step, 100 * step, step, in_mm(self._reach),
            hint="How far from where you drag a stitch may be attached",
        )  # fmt: skip
        running = gui.add_checkbox("Running", self._running, hint="One thread for all stitches")
        tighten = gui.add_button("Tighten", hint="Gives your last stitches the length set above")
        tighten_all = gui.add_button("Tighten all", hint="Every stitch there is, whoever's it is")
        take_out = gui.add_button("Take out", hint="Your last stitches")

        def take() -> None:
            if self._way != way.value:
                self._forget()
            self._way, self._running = way.value, running.value
            self._length, self._reach = length.value * MM, reach.value * MM
            self._spacing = spacing.value * MM
            spacing.visible = running.visible = self._way == LIPS

        for control in (way, length, spacing, reach, running):
            control.on_update(self._person.in_turn(take))
        tighten.on_click(self._person.in_turn(lambda: self._tighten(self._last())))
        tighten_all.on_click(self._person.in_turn(lambda: self._tighten([])))
        take_out.on_click(self._person.in_turn(self._take_out))
        take()

    def leave(self) -> None:
        """Forget what was drawn."""
        self._forget()

    def _forget(self) -> None:
        self._line = self._first_lip = None
        self._marks.clear()

    def _take_lip(self, line: NDArray[np.float64]) -> None:
        lip = spread(line, POINTS)
        if self._first_lip is None:
            self._first_lip = lip
            self._marks.line("lip", lip)
            self._person.tell("Now draw a line along the other lip.")
            return
        first, self._first_lip = self._first_lip, None
        self._marks.clear()
        self._sew(np.concatenate([first, alongside(first, lip)]), self._spacing)

    def _sew(self, positions: NDArray[np.float64], spacing: float) -> None:
        request = Suture.Request(
            action=Suture.Request.SEW, positions=positions.ravel().tolist(), spacing=spacing,
            running=self._running and spacing > 0.0, reach=self._reach, length=self._length,
        )  # fmt: skip
        request.header.frame_id = self._person.desk.frame_id
        self._person.request("suture", request, self._done)

    def _done(self, answer: Suture.Response) -> None:
        made = [int(suture) for suture in answer.made]
        self._sewn.append(made)
        self._person.tell(
            f"Sewn: {counted(len(made))}, pulling {max(answer.forces):.2g} N at most."
        )

    def _last(self) -> list[int]:
        """The newest stitches of this person that are still there."""
        mesh = self._person.desk.replica.mesh
        there = set() if mesh is None else set(mesh.sutures.ids.tolist())
        while self._sewn:
            left = [suture for suture in self._sewn[-1] if suture in there]
            if left:
                return left
            self._sewn.pop()
        raise ValueError("no stitch of yours is there; drag from one side of a wound to the other")

    def _tighten(self, sutures: list[int]) -> None:
        def done(answer: Suture.Response) -> None:
            pull = max(answer.forces, default=0.0)
            self._person.tell(f"Tightened: {counted(len(answer.made))}, {pull:.2g} N at most.")

        request = Suture.Request(
            action=Suture.Request.TIGHTEN, sutures=sutures, length=self._length
        )
        self._person.request("suture", request, done)

    def _take_out(self) -> None:
        last = self._last()
        request = Suture.Request(action=Suture.Request.REMOVE, sutures=last)
        self._person.request(
            "suture", request, lambda _: self._person.tell(f"Taken out: {counted(len(last))}.")
        )


def counted(stitches: int) -> str:
    """So many stitches, in words."""
    return f"{stitches} stitch" if stitches == 1 else f"{stitches} stitches"


def spread(line: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Points at equal distances along a line.

    Args:
        line: Its corners [m], shape (n, 3).
        count: Of the points, at least 2.

    Returns:
        Shape (count, 3).

    Raises:
        ValueError: The line has no length.
    """
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    if way[-1] == 0.0:
        raise ValueError("a lip needs a line along the wound; drag further")
    at = np.linspace(0.0, way[-1], count)
    return np.stack([np.interp(at, way, line[:, axis]) for axis in range(3)], axis=1)


def alongside(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """The second of two lines with as many points in the direction of the first, shape (n, 3).

    People draw the second lip as often back as forth.
    """
    ends = [0, -1]
    same = np.linalg.norm(first[ends] - second[ends], axis=1).sum()
    other = np.linalg.norm(first[ends] - second[[-1, 0]], axis=1).sum()
    return second if same <= other else second[::-1]
