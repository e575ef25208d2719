"""Progressive cuts: strips of a moving blade, planned one after the other while it moves."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable
from dataclasses import asdict, dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cut_service.errors import CutCode, CutError, SweepError
from cut_service.organ import organ_of
from cut_service.outcome import Outcome
from cut_service.sweep import Sweep
from cut_service.swept import Swept
from cut_service.waiting import Until
from cut_service.work import Plan, Settings
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.blade_contact import mean_edge
from tissue_sim.replica import Replica, Shape

FOLLOWS_WITHIN = 2.0
"""Longest wait for the state with an edit that was applied [s]."""

SMALLEST_PIECE = 20
"""Fewer elements are not cut free by one stroke: they stood out of a lip that is passed again."""

TRIES = 3
"""How often strips are planned that could not be applied, if no newer ones come."""

REACH = 3.0
"""Older strips within so many mean edges of a new one are planned with again."""

Pick = Callable[[Mesh, Shape], tuple[Sweep, Settings]]
"""What to cut along, and how, given the tissue as it is when the plan is made."""

Carry = Callable[[Pick, int, bytes, str, str], Awaitable[Outcome]]
"""Plans and applies: what to cut, not before which frame, epoch, author, request id."""


@dataclass(frozen=True)
class Strip:
    """What a blade passed lately; a `CutRequest` that belongs to a stroke.

    Attributes:
        stroke: Id of the stroke.
        number: Counts the strips of the stroke from 0.
        ends: Whether it is the last.
        tool: Whose blade it is.
        epoch: Epoch of the tissue.
        frame: Frame of the newest pose.
        vertices: Corners in the organ's frame [m], shape (n, 3) or flat.
        triangles: Three corners each, shape (m, 3) or flat; none: nothing more was passed.
    """

    stroke: str
    number: int
    ends: bool
    tool: str
    epoch: bytes
    frame: int
    vertices: NDArray[np.float64]
    triangles: NDArray[np.uint32]


@dataclass
class Figures:
    """What was done in a stroke so far.

    Attributes:
        strips: Strips that came.
        missing: Strips that did not.
        plans: Plans made; of those `empty` parted nothing and `failed` could not be applied.
        faces: Faces split or bared.
        plan_ms: Time of each plan that was applied [ms].
        apply_ms: Time inside the loop of each [ms].
        lag: Frames from a pose of the blade to the first state with the tissue open behind it.
    """

    strips: int = 0
    missing: int = 0
    plans: int = 0
    empty: int = 0
    failed: int = 0
    faces: int = 0
    plan_ms: list[float] = field(default_factory=list)
    apply_ms: list[float] = field(default_factory=list)
    lag: list[int] = field(default_factory=list)

    def in_words(self) -> str:
        """One line for people."""
        parts = [f"{self.strips} strips in {self.plans} plans, {self.faces} faces split"]
        if self.empty:
            parts.append(f"{self.empty} parted nothing")
        if self.failed:
            parts.append(f"{self.failed} failed")
        if self.missing:
            parts.append(f"{self.missing} strips were lost on the way")
        if self.plan_ms:
            parts.append(
                f"planned in {np.median(self.plan_ms):.1f} ms (most {max(self.plan_ms):.1f}), "
                f"applied in {np.median(self.apply_ms):.2f} ms (most {max(self.apply_ms):.2f}), "
                f"{np.median(self.lag):.0f} frames behind the blade (most {max(self.lag)})"
            )
        return ", ".join(parts)


@dataclass
class _Picked:
    """What a plan was made on."""

    shape: Shape | None = None


class Stroke:
    """One stroke: what it has passed, and what came of it."""

    def __init__(self, first: Strip) -> None:
        self.id, self.tool, self.epoch = first.stroke, first.tool, first.epoch
        self.frame = 0
        self.over = False
        self.figures = Figures()
        self._seen: set[int] = set()
        self._waiting: list[Strip] = []
        self._swept: Swept | None = None
        self._volume = self._spent = 0.0
        self._failed = 0

    @property
    def waits(self) -> bool:
        """Whether there are strips to plan."""
        return bool(self._waiting) or 0 < self._failed < TRIES

    @property
    def newest(self) -> int:
        """Frame of the newest strip."""
        return max([self.frame, *(strip.frame for strip in self._waiting)])

    def take(self, strip: Strip) -> None:
        """Add a strip; one that comes twice counts once.

        Raises:
            SweepError: It is not finite or names corners it does not have; it is left out.
        """
        if strip.number in self._seen:
            return
        self._seen.add(strip.number)
        self.over = self.over or strip.ends
        self.figures.strips = len(self._seen)
        self.figures.missing = max(self._seen) + 1 - len(self._seen)
        if len(strip.triangles):
            Sweep.from_arrays(strip.vertices, strip.triangles)
            self._waiting.append(strip)

    def give_up(self) -> None:
        """There is no tissue: nothing waits any more."""
        self._waiting.clear()
        self._swept = None

    def pick(self, mesh: Mesh, shape: Shape, settings: Settings) -> tuple[Sweep, Settings]:
        """What to cut along on a shape: all that came so far, joined to what was cut.

        Raises:
            SweepError: It is nothing that can be cut along.
        """
        if self._swept is None:
            self._swept = Swept(REACH * mean_edge(mesh))
            self._volume = organ_of(mesh).volume if mesh.sheet_rows is None else 0.0
        waiting, self._waiting = self._waiting, []
        for strip in waiting:
            self.frame = max(self.frame, strip.frame)
            self._swept.add(strip.vertices, strip.triangles)
        self._swept.carry(shape.positions, mesh.node_alive)
        left = settings.volume_budget
        if self._volume > 0.0:
            left = max(0.0, left - self._spent / self._volume)
        piece = max(settings.smallest_piece, SMALLEST_PIECE)
        settings = replace(settings, volume_budget=left, smallest_piece=piece)
        return self._swept.sweep(), settings

    def done(self, mesh: Mesh, shape: Shape, made: Plan | None, failed: bool = False) -> None:
        """Take note of what became of what was picked.

        Args:
            mesh: The tissue after it.
            shape: Its shape after it.
            made: What was planned and applied; None: nothing.
            failed: Whether there was something to apply, or to find out.
        """
        self._failed = self._failed + 1 if failed else 0
        if made is not None and made.report.method == "split":
            self._spent += abs(made.report.volume_change)
        if self._swept is not None:
            # What cut threads only has parted no tissue yet.
            parted = made if made is not None and len(made.edit.read_elements) else None
            self._swept.planned(shape.positions, mesh.node_alive, parted)


class Strokes:
    """Everybody's strokes, planned one strip after the other by whoever finds nobody at it.

    Strips that come while one is planned wait and are planned together, so that the service never
    falls behind a blade. Strokes of several tools take turns.

    Attributes:
        finished: Strokes that are over.
        last: What became of the last of them, in words.
        last_figures: The same as JSON, see `Figures`.
    """

    def __init__(self, replica: Replica, settings: Settings, say: Callable[[str], None]) -> None:
        """Begin with nothing.

        Args:
            replica: The tissue.
            settings: How to cut.
            say: Where to report each stroke.
        """
        self.finished = 0
        self.last = self.last_figures = ""
        self._replica, self._settings, self._say = replica, settings, say
        self._strokes: dict[tuple[bytes, str], Stroke] = {}
        self._working = False

    async def take(self, strip: Strip, carry_out: Carry) -> None:
        """Add a strip; plan until there is nothing to plan, unless somebody does already."""
        self._drop_others(strip.epoch)
        key = (strip.epoch, strip.stroke)
        if key not in self._strokes:
            self._strokes[key] = Stroke(strip)
        try:
            self._strokes[key].take(strip)
        except SweepError as error:
            self._say(f"strip by {strip.tool} left out: {error}")
        if self._working:
            return
        self._working = True
        try:
            while (stroke := self._next()) is not None:
                await self._work(stroke, carry_out)
                # Now it is everybody else's turn.
                key = (stroke.epoch, stroke.id)
                if key in self._strokes:
                    self._strokes[key] = self._strokes.pop(key)
        finally:
            self._working = False

    def _drop_others(self, epoch: bytes) -> None:
        """Strokes of an epoch that is over end without a word of their blade."""
        for key, stroke in list(self._strokes.items()):
            if key[0] != epoch:
                del self._strokes[key]
                self._say(
                    f"stroke by {stroke.tool} ended with its epoch: {stroke.figures.in_words()}"
                )

    def _next(self) -> Stroke | None:
        """The stroke to work on; those that are over are reported."""
        for key, stroke in list(self._strokes.items()):
            if stroke.waits:
                return stroke
            if not stroke.over:
                continue
            del self._strokes[key]
            self.finished += 1
            self.last = f"stroke by {stroke.tool}: {stroke.figures.in_words()}"
            self.last_figures = json.dumps(asdict(stroke.figures))
            self._say(self.last)
        return None

    async def _work(self, stroke: Stroke, carry_out: Carry) -> None:
        figures, picked = stroke.figures, _Picked()

        def pick(mesh: Mesh, shape: Shape) -> tuple[Sweep, Settings]:
            picked.shape = shape
            return stroke.pick(mesh, shape, self._settings)

        figures.plans += 1
        outcome = await self._carried_out(stroke, pick, carry_out)
        replica = self._replica
        await Until(
            lambda: replica.newest_version >= outcome.version or replica.epoch != stroke.epoch,
            FOLLOWS_WITHIN,
        )
        mesh, shape = replica.mesh, picked.shape
        if mesh is None or shape is None or replica.epoch != stroke.epoch:
            stroke.give_up()
            return
        after = replica.shape_at(shape.frame) or replica.shape_at()
        if after is not None:
            failed = bool(outcome.code) and not outcome.code.nothing_to_cut
            stroke.done(mesh, after, outcome.plan, failed)
        else:
            stroke.give_up()
        if outcome.code.nothing_to_cut:
            figures.empty += 1
        elif outcome.code:
            figures.failed += 1
            self._say(f"strip by {stroke.tool} failed: {outcome.message}")
        elif outcome.plan is not None:
            figures.faces += outcome.plan.report.faces_split
            figures.plan_ms.append(outcome.plan.report.plan_ms)
            figures.apply_ms.append(outcome.apply_ms)
            figures.lag.append(max(0, replica.newest_frame - stroke.frame))

    @staticmethod
    async def _carried_out(stroke: Stroke, pick: Pick, carry_out: Carry) -> Outcome:
        frame = stroke.newest
        try:
            return await carry_out(pick, frame, stroke.epoch, stroke.tool, f"{stroke.id}/{frame}")
        except CutError as error:
            return Outcome(error.code, str(error))
        except Exception as error:
            # Whatever went wrong, the strips after this one are still cut.
            return Outcome(CutCode.REFUSED, f"planning failed: {type(error).__name__}: {error}")
