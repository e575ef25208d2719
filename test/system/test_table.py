"""The operating table in a real browser: people in windows of their own, at one organ."""

from __future__ import annotations

import re
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from tissue_interfaces.msg import Tool

from support.browser import Windows, windows
from support.fake_simulation import spinning, wait_for
from support.observer import PATIENCE, Observer
from support.processes import Processes, processes
from tissue_sim.geometry.components import connected_components
from tool_input.browser.window import Window

SOON = 120.0
"""Longest wait for what a window asked for [s]; only a failing test waits so long."""
LOWER, UPPER = (0.5, 0.3, 1.0), (0.5, 0.7, 1.0)
"""Places on the wall's upper side, as shares of its length, width and thickness."""


class Table:
    """A session on the wall, watched from outside, and the addresses of its page."""

    def __init__(self, world: Processes, browser: Windows, seen: Observer) -> None:
        self.world = world
        self.browser = browser
        self.seen = seen
        self.rest = np.empty((0, 3), dtype=np.float32)
        self._open: dict[str, Window] = {}

    def begin(self, scene: Path) -> None:
        self.world.start(
            "simulation", "tissue_sim.simulation_node", "--ros-args", "--params-file", str(scene),
            "-p", "rate_hz:=30.0", "-p", "steps_per_frame:=2", "-p", "wait_for:=['tissue/state:2']",
        )  # fmt: skip
        self.world.start("cut", "cut_service.cut_node")
        self.world.start(
            "table", "tool_input.table_node", "--ros-args", "-p", "view_hz:=10.0", "-p", "port:=0"
        )
        self.seen.wait_ready()
        wait_for(lambda: len(self.addresses) == 2, PATIENCE, "the page's addresses")
        wait_for(self.seen.cuts.service_is_ready, PATIENCE, "tissue/cut")
        self.rest = self.seen.positions.copy()

    @property
    def addresses(self) -> list[str]:
        """To take part, and to watch."""
        return re.findall(r"http://\S+token=\S+", self.world.log("table"))

    def person(self, name: str) -> Window:
        """Somebody takes part under this name."""
        return self.browser.open(self.addresses[0].replace("/?", f"/as/{name}?"))

    def tools(self, name: str) -> list[Tool]:
        """A person's tools."""
        return [tool for tool in list(self.seen.tools.values()) if tool.id.startswith(name)]

    def holds(self, name: str) -> bool:
        return any(tool.pressed for tool in self.tools(name))

    def moved(self, place: tuple[float, ...]) -> float:
        """How far the tissue that rests about a place has gone [m]."""
        lower, upper = self.rest.min(axis=0), self.rest.max(axis=0)
        away = np.linalg.norm(self.rest - (lower + np.array(place) * (upper - lower)), axis=1)
        near = np.flatnonzero(away < 0.006)
        return float(np.linalg.norm(self.seen.positions[near] - self.rest[near], axis=1).max())

    def comes_about(self, holds: Callable[[], bool], what: str) -> None:
        wait_for(holds, SOON, what)


@contextmanager
def table(domain: int, folder: Path, repository: Path) -> Iterator[Table]:
    with (
        windows() as browser,
        processes(folder) as world,
        spinning(domain, Observer) as seen,
    ):
        made = Table(world, browser, seen)
        made.begin(repository / "config" / "wall.yaml")
        yield made


def answer(address: str) -> int:
    """Status of a request without cookies."""
    try:
        with urllib.request.urlopen(address, timeout=SOON) as response:
            return int(response.status)
    except urllib.error.HTTPError as error:
        return error.code


def parts(seen: Observer) -> int:
    mesh = seen.mesh
    rows = mesh.element_rows
    return connected_components(mesh.tets[:rows], mesh.element_alive[:rows], mesh.node_rows)[0]


def test_people_work_at_one_table(ros_domain: int, tmp_path: Path, repository: Path) -> None:
    with table(ros_domain, tmp_path, repository) as at:
        strangers_are_refused(at)
        anna = at.person("anna")
        two_people_pull_at_once_and_who_leaves_lets_go(at, anna)
        drawn = a_drawn_cut_opens_the_tissue_and_undo_closes_it(at, anna)
        who_watches_cannot_act(at, anna, drawn)


def strangers_are_refused(at: Table) -> None:
    take_part, watch = at.addresses
    page, token = take_part.split("?token=")
    assert answer(page) == 403
    assert answer(f"{page}?token={token[:-1]}") == 403
    # What lets in to watch does not let in to take part.
    assert answer(f"{page}?token={watch.split('=')[1]}") == 403


def two_people_pull_at_once_and_who_leaves_lets_go(at: Table, anna: Window) -> None:
    bert = at.person("bert")
    for window, place in ((anna, LOWER), (bert, UPPER)):
        start = window.tissue_at(place)
        window.press(start)
        window.pull(start, start + np.array([25.0, -25.0]))
    at.comes_about(lambda: at.holds("anna") and at.holds("bert"), "two holds")
    at.comes_about(lambda: min(at.moved(LOWER), at.moved(UPPER)) > 0.003, "tissue pulled by both")
    assert len({tool.owner for name in ("anna", "bert") for tool in at.tools(name)}) == 2
    # His mouse is still pressed: what a connection held that is gone is let go.
    pulled = at.moved(UPPER)
    bert.close()
    at.comes_about(lambda: at.tools("bert") == [], "the end of his tools")
    at.comes_about(lambda: at.moved(UPPER) < 0.5 * pulled, "tissue that is free again")
    assert at.holds("anna")
    anna.release()
    at.comes_about(lambda: not at.holds("anna"), "her release")
    at.comes_about(lambda: at.moved(LOWER) < 0.002, "the wall at rest")


def a_drawn_cut_opens_the_tissue_and_undo_closes_it(at: Table, anna: Window) -> list[Any]:
    """What her page has sent for it."""
    version = at.seen.mesh.version
    said = len(anna.said())
    anna.key("C")
    anna.drag(anna.tissue_at((0.06, 0.5, 1.0)), anna.tissue_at((0.94, 0.5, 1.0)))
    at.comes_about(lambda: at.seen.mesh.version > version, "the cut")
    drawn = anna.said()[said:]
    assert parts(at.seen) == 2
    anna.click("Undo")
    at.comes_about(lambda: parts(at.seen) == 1, "the cut undone")
    return drawn


def who_watches_cannot_act(at: Table, anna: Window, drawn: list[Any]) -> None:
    version, rest = at.seen.mesh.version, at.moved(LOWER)
    watcher = at.browser.open(at.addresses[1])
    assert watcher.page.get_by_role("button", name="Undo").count() == 0
    start = watcher.tissue_at(LOWER)
    watcher.drag(start, start + np.array([25.0, -25.0]))
    # Nor by a page that sends what the page of one who takes part has sent.
    for message in drawn:
        watcher.forge(message)
    at.seen.wait_frames(60)
    assert at.seen.mesh.version == version
    assert at.tools("observer") == []
    assert at.moved(LOWER) < rest + 0.001
    for message in drawn:
        anna.forge(message)
    at.comes_about(lambda: at.seen.mesh.version > version, "the same cut from her own page")
