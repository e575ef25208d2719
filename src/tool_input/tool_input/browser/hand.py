"""A hand with a mouse that pulls the organ in one window, and what the page noted meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tool_input.browser.window import Window
from tool_input.table_latency import PageNotes

WAY = np.array([24.0, -18.0])
"""How far it pulls [pixels]: 30 to the upper right."""
MARGIN = 60
"""Half the width of the region about the grip whose pixels are compared."""
FEWEST = 40
"""Pixels that must have changed for a frame to count as another picture."""
LEAST = 0.25
"""Share of the way that the tissue must have gone to count as moved."""
MOUSE_MS = 16.0
"""Between two moves of the hand that pulls back and forth."""
BACK = 0.125
"""Share of the way within which tissue that was let go of counts as back."""
PATIENCE = 120.0
"""Longest wait for tissue that is pulled or let go of [s]: a page that draws slowly tells late."""

_PLACE = """() => Array.from(
    watch.meshes[watch.follow.mesh].vertices.subarray(
        3 * watch.follow.vertices[0], 3 * watch.follow.vertices[0] + 3))"""
# Tissue that rests is not sent: where it is when the notes begin is noted first.
_FORGET = f"""() => {{
    for (const list of ["pointer", "sent", "batches", "frames"]) watch[list].length = 0;
    watch.batches.push([performance.now(), 0, [({_PLACE})()]]);
}}"""
_SEEN = """([since, rest, least, fewest]) => {
    const far = ([place]) => Math.hypot(...place.map((at, axis) => at - rest[axis])) >= least;
    const came = watch.batches.find(([at, _, places]) => at > since && places && far(places));
    return came !== undefined
        && watch.frames.some(([at, changed]) => at > came[0] && changed >= fewest);
}"""
_NOTES = """() => ({
    origin: performance.timeOrigin, moves: watch.pointer, sent: watch.sent,
    batches: watch.batches, frames: watch.frames,
})"""
_NOW = "() => performance.now()"


@dataclass(frozen=True)
class Moves:
    """Single moves of the mouse.

    Attributes:
        made: When the browser had each, in seconds since 1970.
        page: What the page noted.
        least: How far the followed vertex must have gone to have moved, in the page's units.
    """

    made: list[float]
    page: PageNotes
    least: float


class Hand:
    """A hand with a mouse on one window."""

    def __init__(self, window: Window, grip: tuple[float, ...]) -> None:
        """Go to where it takes hold.

        Args:
            window: The window.
            grip: Where, as shares of the organ's extent.
        """
        self._window = window
        self._page = window.page
        self._start = window.tissue_at(grip)
        camera = window.camera
        # The vertex in sight there, whichever mesh shows it.
        depth, mesh, row = min(
            (float((part.vertices[row] - camera.position) @ camera.axes[:, 2]), part.name, int(row))
            for part in window.organ()
            for row in np.flatnonzero(
                np.linalg.norm(camera.pixels(part.vertices) - self._start, axis=1) < 0.5
            )
        )
        self._way = float(np.linalg.norm(WAY)) * depth / camera.focal
        follow = {"mesh": mesh, "vertices": [row]}
        self._page.evaluate("(follow) => { watch.follow = follow; }", follow)
        self._home = np.array(self._page.evaluate(_PLACE))
        # What is done for the first time takes longer, in the page and in the simulation.
        self._take_hold()
        self._let_go()

    def _gone(self) -> float:
        """How far the followed vertex is from where it was at rest, in the page's units."""
        return float(np.linalg.norm(np.array(self._page.evaluate(_PLACE)) - self._home))

    def _take_hold(self) -> None:
        """Press and pull until the page shows the tissue following; it is held when this returns.

        Raises:
            TimeoutError: It does not follow.
        """
        self._window.press(self._start)

        def follows() -> bool:
            # A page that draws slowly begins the drag late and misses the moves before that.
            self._window.pull(self._start, self._start + WAY, 2)
            return self._gone() >= LEAST * self._way

        self._window.until(follows, "the tissue following the hand", PATIENCE)

    def _let_go(self) -> None:
        """Release, and wait until the page shows the tissue back where it was.

        Raises:
            TimeoutError: It does not come back.
        """
        self._window.release()
        self._wait_back()

    def _wait_back(self) -> None:
        self._window.until(
            lambda: self._gone() < BACK * self._way, "the tissue where it was", PATIENCE
        )

    def blindfold(self, blind: bool) -> None:
        """Leave drawing out, or draw again."""
        self._page.evaluate("(blind) => { watch.blind = blind; }", blind)

    def count(self, seconds: float) -> dict[str, float]:
        """Pull back and forth for some seconds.

        Returns:
            Frames of the organ that came (`received_hz`) and pictures of them that the page got
            through (`drawn_hz`) a second, and the size of one (`kb_per_frame`).
        """
        self._take_hold()
        self._page.evaluate(_FORGET)
        before = self._page.evaluate(_NOW)
        end = before + seconds * 1e3
        while (now := self._page.evaluate(_NOW)) < end:
            for share in (0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0):
                self._window.move(self._start + share * WAY)
                self._page.wait_for_timeout(MOUSE_MS)
        notes = self._page.evaluate(_NOTES)
        self._let_go()
        took = (now - before) / 1e3
        bytes_each = [size for _, size, _ in notes["batches"] if size]
        return {
            "received_hz": round(len(bytes_each) / took, 1),
            "drawn_hz": round(sum(new for _, _, new in notes["frames"]) / took, 1),
            "kb_per_frame": round(float(np.median(bytes_each or [0])) / 1e3, 1),
        }

    def single_moves(self, count: int, rest: float, patience: float) -> Moves:
        """Move back and forth, each time when the last move was seen and the tissue is at rest.

        Args:
            count: How many moves.
            rest: For how long the tissue is left alone after each [s].
            patience: How long a move may take to be seen [s]; one that is not counts as lost.

        Raises:
            TimeoutError: The tissue does not follow the hand.
        """
        x, y = (int(at) - MARGIN for at in np.round(self._start))
        region = [x, y, 2 * MARGIN, 2 * MARGIN]
        self._page.evaluate("(region) => { watch.region = region; }", region)
        self._take_hold()
        self._window.move(self._start)
        self._wait_back()
        self._page.wait_for_timeout(1e3 * rest)
        self._page.evaluate(_FORGET)
        for move in range(count):
            self._move_and_see(move % 2 == 0, patience)
            self._page.wait_for_timeout(1e3 * rest)
        notes = self._page.evaluate(_NOTES)
        self._let_go()
        made = [(notes["origin"] + at) / 1e3 for at in notes["moves"]]
        return Moves(made, PageNotes.read(notes, FEWEST), LEAST * self._way)

    def _move_and_see(self, away: bool, patience: float) -> None:
        asked = [self._page.evaluate(_NOW), self._page.evaluate(_PLACE), LEAST * self._way, FEWEST]
        self._window.move(self._start + (WAY if away else 0.0))
        try:
            self._window.until(
                lambda: self._page.evaluate(_SEEN, asked), "a move of the mouse", patience
            )
        except TimeoutError:
            return
