"""The report of a comparison: JSON, page, plots, pictures and the table in a terminal."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from support.pulled_block import PULL, block_organ, pull_of, top_of
from tissue_sim.compare.comparison import Comparison, Target, compare
from tissue_sim.compare.interaction import held_along
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.organs import load_organ
from tissue_sim.compare.report import figures, pictures
from tissue_sim.compare.report.page import page, write_page
from tissue_sim.compare.report.result import result_of, write_result
from tissue_sim.compare.report.text import print_comparison, print_summary, summary_rows
from tissue_sim.compare.sources.motions import motion
from tissue_sim.compare.subject import parse_subject
from tissue_sim.compare.trajectory import Trajectory

EXACT = "exact=finite_element@rest"
TARGETS = ("relaxation@1", "<b>soft & slow</b>=quasi_static@0.5", "vertex_block_descent@2")
VOID = {"meta", "link", "img", "br"}
NO_DRAWING = pictures.Pictures((), "no pictures: nobody draws here")


def compared(organ: Organ, name: str = "pull", targets: Sequence[str] = TARGETS) -> Comparison:
    subjects = [parse_subject(text) for text in targets]
    return compare(organ, pull_of(organ, name=name), parse_subject(EXACT), subjects)


def with_lost(comparison: Comparison) -> Comparison:
    """The same, with its first target lost in the third frame."""
    first = comparison.targets[0]
    lost = Target(
        first.subject, replace(first.trajectory, stable=2), first.difference, first.relative
    )
    return replace(comparison, targets=(lost, *comparison.targets[1:]))


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compared(block_organ())


@pytest.fixture(scope="module")
def measured(comparison: Comparison) -> Comparison:
    """Against a measurement of four nodes."""
    reference = comparison.reference
    rows = np.array([3, 20, 40, 50], dtype=np.int32)
    nothing = np.empty(0)
    partly = Trajectory(
        "camera", 30.0, reference.displacement, nothing.astype(np.int64), nothing,
        reference.frames, reference.organ, rows,
    )  # fmt: skip
    targets = [target.subject for target in comparison.targets]
    return compare(comparison.organ, comparison.interaction, partly, targets)


# JSON


def refused(constant: str) -> None:
    raise AssertionError(f"{constant} is no JSON")


def test_the_result_is_strict_json_in_si_units(comparison: Comparison, tmp_path: Path) -> None:
    file = tmp_path / "new" / "result.json"
    write_result(file, [comparison], "tissue compare block")
    found = json.loads(file.read_text(encoding="utf-8"), parse_constant=refused)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert (found["format"], found["made"]["command"]) == (1, "tissue compare block")
    one = found["comparisons"][0]
    assert one["organ"]["nodes"] == 64
    assert one["organ"]["fixed_nodes"] == 16
    assert one["interaction"]["amplitude_m"] == pytest.approx(np.linalg.norm(PULL))
    assert one["ranking"] == [target.subject.name for target in comparison.ranking]
    for told, target in zip(one["targets"], comparison.targets, strict=True):
        assert parse_subject(told["text"]) == target.subject
        assert told["relative"] == target.relative
        assert np.mean(told["frames"]["mean_m"]) == pytest.approx(told["mean_m"], rel=1e-6)
        np.testing.assert_allclose(told["nodes"]["mean_m"], target.difference.node_mean, rtol=1e-6)
        assert sum(told["trajectory"]["steps"]) == target.trajectory.steps.sum()


def test_what_is_not_a_number_is_null(measured: Comparison) -> None:
    document = result_of([measured])
    json.dumps(document, allow_nan=False)
    one = document["comparisons"][0]
    assert one["reference"]["subject"] is None
    assert one["reference"]["measured_nodes"] == 4
    assert one["reference"]["ms_per_frame"] is None
    for told in one["targets"]:
        assert told["largest_volume_error"] is None
        known = [row for row, value in enumerate(told["nodes"]["mean_m"]) if value is not None]
        assert known == [3, 20, 40, 50]


# Page


class Page(HTMLParser):
    """Checks that elements are closed, and collects what the page refers to and is made of."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.count: dict[str, int] = {}
        self.words = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.count[tag] = self.count.get(tag, 0) + 1
        given = dict(attrs)
        self.addresses += [value for key in ("src", "href") if (value := given.get(key))]
        self.ids += [value] if (value := given.get("id")) else []
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("script", "style"):
            self.words += data + "\n"


def test_the_page_is_whole_and_needs_nothing_else(comparison: Comparison, tmp_path: Path) -> None:
    file = tmp_path / "new" / "report.html"
    drawn = pictures.Pictures(tuple(b"\x89PNG" for _ in TARGETS))
    write_page(file, with_lost(comparison), "tissue compare 'a <b>'", lambda _: drawn)
    text = file.read_text(encoding="utf-8")
    found = Page(text)
    assert len(found.addresses) == len(TARGETS)
    assert all(address.startswith("data:image/png;base64,") for address in found.addresses)
    assert len(set(found.ids)) == len(found.ids) == 7
    assert "plotly.js v" in text
    assert "<b>soft" not in found.words.replace("<b>soft & slow</b>", "")
    for words in ("<b>soft & slow</b>", "tissue compare 'a <b>'", "64 nodes",
                  "exact (finite_element, to rest)",
                  "relaxation is unstable: lost in frame 3 of 6 (0.07 s)", "What they do not say",
                  comparison.organ.digest):  # fmt: skip
        assert words in found.words
    assert list(tmp_path.rglob("*.partial")) == []


def test_several_interactions_have_a_section_each_and_a_summary(comparison: Comparison) -> None:
    other = replace(comparison, interaction=replace(comparison.interaction, name="push"))
    found = Page(page([comparison, other], draw=lambda _: NO_DRAWING))
    assert "Interaction: pull" in found.words
    assert "Interaction: push" in found.words
    assert "All interactions" in found.words
    assert len(set(found.ids)) == len(found.ids) == 2 * 7 + 1
    assert found.words.count(NO_DRAWING.message) == 2
    for name, shares in summary_rows([comparison, other]):
        target = next(t for t in comparison.targets if t.subject.name == name)
        assert shares == [target.relative] * 2


def test_measurements_and_sheets_have_a_page_too(measured: Comparison) -> None:
    assert "camera, 4 nodes of it" in Page(page([measured], draw=lambda _: NO_DRAWING)).words
    organ = load_organ(
        "wall", parameters={"columns": 5, "rows": 6}, geometry_kind="connected_surfaces"
    )
    sheet = compare(
        organ, motion("normal", organ, 0.004, pull_seconds=0.1, hold_seconds=0.1),
        parse_subject("quasi_static@9"), [parse_subject("relaxation@1")],
    )  # fmt: skip
    assert figures.volume_over_time(sheet) is None
    assert "triangles" in Page(page([sheet], draw=lambda _: NO_DRAWING)).words


# Plots


def test_plots_show_the_differences_in_millimetres(comparison: Comparison) -> None:
    shown = {trace.name: trace for trace in figures.over_time(comparison).data if trace.name}
    volumes = figures.volume_over_time(comparison)
    assert volumes is not None
    for target, volume in zip(comparison.ranking, volumes.data, strict=True):
        trace = shown[target.subject.name]
        np.testing.assert_allclose(trace.y, 1e3 * target.difference.frame_mean)
        np.testing.assert_allclose(trace.x, np.arange(1, 7) / 30.0)
        np.testing.assert_allclose(volume.y, 100 * target.difference.volume_error)
        assert volume.line.color == trace.line.color
    bars = figures.relative_bars(comparison).data[0]
    assert list(bars.x)[::-1] == [target.relative for target in comparison.ranking]


def test_times_without_a_hold_are_not_shaded() -> None:
    organ = block_organ()
    held = np.array([True, True, False, False, True, False])
    again = held_along(organ, "regrab", 30.0, top_of(organ), np.tile(PULL, (6, 1)), held)
    found = compare(organ, again, parse_subject(EXACT), [parse_subject("relaxation@1")])
    shaded = [(shape.x0, shape.x1) for shape in figures.over_time(found).layout.shapes]
    np.testing.assert_allclose(shaded, np.array([[0, 2], [4, 5]]) / 30.0)


def test_the_map_has_a_difference_for_every_node_of_the_surface(measured: Comparison) -> None:
    mesh = figures.node_map(measured).data[0]
    assert len(mesh.x) == len(mesh.intensity) == 64 - 8
    assert sum(value is not None for value in mesh.intensity) <= 4
    assert max(mesh.i.max(), mesh.j.max(), mesh.k.max()) == len(mesh.x) - 1


# Pictures


def test_all_pictures_have_the_same_view_and_colours(comparison: Comparison) -> None:
    top = pictures.colour_limit(comparison)
    assert top >= 1e3 * max(t.difference.frame_p95[-1] for t in comparison.targets)
    views = []
    for target in comparison.targets:
        frames = pictures.moments(target)
        arrays = pictures.panels(comparison, target, top)
        assert arrays["grid"][:2].tolist() == [len(frames), 2]
        assert arrays["range_mm"].tolist() == [0.0, top]
        for row, frame in enumerate(frames):
            reference, ours = (f"panel{2 * row + column}_mm" for column in range(2))
            np.testing.assert_array_equal(arrays[reference], arrays[ours])
            assert arrays[ours].max() <= 1e3 * target.difference.frame_largest[frame] + 1e-6
        views += [arrays[key] for key in arrays if key.endswith("_camera")]
    for view in views:
        np.testing.assert_array_equal(view, views[0])


def test_a_lost_model_does_not_fade_the_others(comparison: Comparison) -> None:
    first = comparison.targets[0]
    far = replace(first.difference, frame_p95=1e3 * first.difference.frame_p95)
    exploded = replace(comparison, targets=(replace(first, difference=far),))
    assert pictures.colour_limit(exploded) < 1e4 * comparison.worst.frame_p95.max()


def test_nodes_that_nobody_measured_have_no_colour(measured: Comparison) -> None:
    arrays = pictures.panels(measured, measured.targets[0], 1.0)
    assert arrays["grid"][1] == 1  # The target only: nobody knows where all of the organ was.
    assert np.isfinite(arrays["panel0_mm"]).sum() <= 4


def test_pictures_are_drawn_or_it_is_said_why_not(comparison: Comparison) -> None:
    drawn = pictures.draw(replace(comparison, targets=comparison.targets[:1]))
    if drawn.message:
        assert drawn.png == ()
    else:
        assert [png[:8] for png in drawn.png] == [b"\x89PNG\r\n\x1a\n"]


# Terminal


@pytest.mark.parametrize("width", [80, 120])
def test_the_table_fits_a_terminal(comparison: Comparison, width: int) -> None:
    file = io.StringIO()
    console = Console(file=file, width=width)
    print_comparison(with_lost(comparison), console)
    print_summary([comparison, comparison], console)
    lines = file.getvalue().splitlines()
    assert max(len(line) for line in lines if "  " in line) <= width  # Sentences may be longer.
    table = next(line for line in lines if "vertex_block_descent" in line).split()
    target = next(t for t in comparison.targets if t.subject.model == "vertex_block_descent")
    assert table[1:3] == [f"{1e3 * target.difference.mean:.3f}", f"{target.relative:.3f}"]
    assert len(table) == 8
    assert any(line.startswith("relaxation is unstable: lost in frame 3 of 6") for line in lines)


def test_times_that_cannot_be_repeated_are_said(comparison: Comparison) -> None:
    first: Any = comparison.targets[0]
    timed = replace(first, subject=parse_subject("relaxation@1ms"))
    file = io.StringIO()
    print_comparison(replace(comparison, targets=(timed,)), Console(file=file, width=80))
    assert "not reproducible, given time instead of steps: relaxation" in file.getvalue()
