"""Length, depth and deviation of cuts whose figures are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cut_service.planner import METHODS, plan
from cut_service.sweep import Sweep
from support.cut_sheets import square
from support.sheets import sheet_mesh, strip
from support.split_edit import split_at
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.report.cut_surface import CutSurface, OpenedFaces, surface_of_cut
from tissue_sim.report.plan import PlannedLine, PlannedSweep, deviation_of, read_plan
from tissue_sim.report.session import CutMade, Session
from tissue_sim.report.summary import Settings, figures_of
from tool_input.located_yaml import ProcedureError

WIDTH, THICK = 0.04, 0.006
"""A plate 40 x 40 x 6 mm; its nodes are 4, 4 and 2 mm apart."""
MIDDLE = 0.02


def plate() -> Mesh:
    return Mesh(block(11, 11, 4, WIDTH, WIDTH, THICK))


def rectangle(y_from: float, y_to: float, z_from: float, z_to: float, tilt: float = 0.0) -> Sweep:
    """A sweep near the plane x = MIDDLE; `tilt` is what x grows with y."""
    y, z = np.array([y_from, y_to, y_to, y_from]), np.array([z_from, z_from, z_to, z_to])
    corners = np.stack([MIDDLE + tilt * (y - MIDDLE), y, z], axis=1)
    return Sweep.from_arrays(corners, [[0, 1, 2], [0, 2, 3]])


def cut(mesh: Mesh, sweep: Sweep, method: str = METHODS[0]) -> CutSurface:
    opened = OpenedFaces()
    assert [len(faces) for faces in opened.look(mesh)] == [0, 0]
    mesh.apply(plan(mesh, mesh.rest[: mesh.node_rows], sweep, method).edit)
    return surface_of_cut(mesh, *opened.look(mesh))


def test_a_cut_through_a_plate_is_as_long_and_as_deep_as_the_plate() -> None:
    """From side to side: its lines run along top and bottom; the ends are other surfaces."""
    mesh, opened = plate(), OpenedFaces()
    opened.look(mesh)
    mesh.apply(split_at(mesh, MIDDLE))
    found = surface_of_cut(mesh, *opened.look(mesh))
    assert found.area == pytest.approx(WIDTH * THICK)
    assert found.length == pytest.approx(WIDTH)
    assert [round(1e3 * float(np.ptp(line[:, :, 1]))) for line in found.lines[:2]] == [40, 40]
    assert found.mean_depth == pytest.approx(THICK)
    assert found.depth == pytest.approx(THICK)


def test_a_cut_that_does_not_go_through_is_as_deep_as_the_blade() -> None:
    mesh = plate()
    found = cut(mesh, rectangle(0.0079, 0.0321, 0.0019, 0.1))
    assert found.length == pytest.approx(0.024, abs=1e-3)
    assert found.depth == pytest.approx(0.004, abs=2e-4)
    assert found.mean_depth == pytest.approx(0.004, rel=0.1)
    assert len(found.lines) == 1


@pytest.mark.parametrize("method", ["split", "subdivide"])
def test_length_does_not_depend_on_how_tissue_is_divided(method: str) -> None:
    """A cut along a line between the nodes: its faces lie on the sweep, whichever way it is cut."""
    found = cut(plate(), rectangle(-0.1, 0.1, -0.1, 0.1, tilt=0.3), method)
    assert found.length == pytest.approx(WIDTH * np.hypot(1.0, 0.3), rel=0.02)
    assert found.area == pytest.approx(found.length * THICK, rel=0.02)


def test_a_second_cut_is_measured_by_itself() -> None:
    mesh, opened = plate(), OpenedFaces()
    opened.look(mesh)
    for x in (0.012, 0.028):
        mesh.apply(split_at(mesh, x))
        lip, other = opened.look(mesh)
        assert len(lip) == len(other) == 60
        assert surface_of_cut(mesh, lip, other).area == pytest.approx(WIDTH * THICK)
    assert [len(faces) for faces in opened.look(mesh)] == [0, 0]


def test_the_mean_depth_is_that_of_cuts_that_have_one() -> None:
    """A slit of 40 x 6 mm; a sheet's cut has no area, one inside a wall no length."""
    mesh, opened = plate(), OpenedFaces()
    opened.look(mesh)
    mesh.apply(split_at(mesh, MIDDLE))
    through = surface_of_cut(mesh, *opened.look(mesh))
    in_sheet, inside = replace(through, faces=np.empty((0, 3, 3))), replace(through, lines=())
    cuts = tuple(
        CutMade("split", "knife", 0.0, 0.0, 1, 0, surface, surface.faces)
        for surface in (through, in_sheet, inside)
    )
    session = Session("s", "s", "plate", "", 0, (), np.zeros(1), 60.0, 0.0, cuts=cuts)
    value = {figure.key: figure.value for figure in figures_of(session, Settings())}
    assert value["cuts.length"] == pytest.approx(2 * WIDTH)
    assert value["cuts.mean_depth"] == pytest.approx(THICK)


def test_a_cut_in_a_sheet_has_a_length_and_no_depth() -> None:
    """Across a strip 20 edges wide, along its straight lines of edges."""
    mesh, edge = sheet_mesh(strip(21, 12), thickness=0.001), 0.002
    height = 5 * np.sqrt(0.75) * edge
    along, up = np.array([0.011, 0.0, 0.0]), np.array([0.0, 0.0, 0.01])
    found = cut(mesh, square(np.array([0.02, height, 0.0]), along, up))
    assert found.length == pytest.approx(0.022, abs=2 * edge)
    assert len(found.lines) == 1
    assert np.isnan([found.area, found.depth]).all()


def test_deviation_from_a_planned_line_is_that_of_straight_lines() -> None:
    """A cut that leaves its plan by slope s over +-h about the middle: RMS s h / sqrt 3."""
    slope, half = 0.1, 0.5 * WIDTH
    found = cut(plate(), rectangle(-0.1, 0.1, -0.1, 0.1, tilt=slope))
    planned = PlannedLine("middle", np.array([[MIDDLE, 0.0, THICK], [MIDDLE, WIDTH, THICK]]))
    apart = deviation_of(found, found.faces, [planned])
    assert apart is not None
    assert apart.plan == "middle"
    assert apart.rms == pytest.approx(slope * half / np.sqrt(3.0), rel=0.03)
    assert apart.largest == pytest.approx(slope * half, rel=0.01)
    assert apart.missed == pytest.approx(slope * half / np.hypot(1.0, slope), rel=0.03)


def test_a_cut_that_is_too_short_misses_the_plan_but_does_not_leave_it() -> None:
    found = cut(plate(), rectangle(-0.1, 0.0201, -0.1, 0.1))
    line = np.array([[MIDDLE, 0.0, THICK], [MIDDLE, WIDTH, THICK]])
    far = PlannedLine("far", line + np.array([0.01, 0.0, 0.0]))
    apart = deviation_of(found, found.faces, [far, PlannedLine("near", line)])
    assert apart is not None
    assert apart.plan == "near"
    assert (apart.rms, apart.largest) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert apart.missed == pytest.approx(WIDTH - 0.020)


def test_deviation_from_a_planned_sweep_is_where_the_tissue_was() -> None:
    """Faces 1 mm beside a planned plane; the same tissue at rest is 3 mm away."""
    beside = np.array([0.003, 0.0, 0.0])
    mesh, opened = plate(), OpenedFaces()
    opened.look(mesh)
    mesh.apply(split_at(mesh, MIDDLE))
    found = surface_of_cut(mesh, *opened.look(mesh))
    sweep = rectangle(-0.1, 0.1, -0.1, 0.1)
    planned = PlannedSweep("sweep", sweep.vertices + beside, sweep.triangles.astype(np.uint32))
    apart = deviation_of(found, found.faces + 2 / 3 * beside, [planned])
    assert apart is not None
    assert (apart.rms, apart.largest) == pytest.approx((1e-3, 1e-3))
    assert np.isnan(apart.missed)
    nothing = CutSurface(np.empty((0, 3, 3)), ())
    assert deviation_of(nothing, nothing.faces, [planned]) is None


def test_plans_are_read_in_their_unit(tmp_path: Path, repository: Path) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text("units: mm\nlines:\n- {name: wall, points: [[0, 0, 0], [10, 0, 0]]}\n")
    (line,) = read_plan(file)
    assert isinstance(line, PlannedLine)
    assert line.points.tolist() == [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]]
    (sweep,) = read_plan(repository / "config" / "procedures" / "demo.yaml")
    assert isinstance(sweep, PlannedSweep)
    assert "demo.yaml:" in sweep.name


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("units: mm\nlines: []\n", "at least one line"),
        ("units: mm\nlines:\n- {name: a, points: [[0, 0, 0]]}\n", "at least 2 points"),
        ("units: feet\nlines: []\n", "m, mm"),
        ("lines: []\n", "'units' is missing"),
        ("units: mm\ntools: {}\ntimeline: [{at: 0, label: a}]\n", "no cut step"),
        ("[1, 2", "no valid YAML"),
    ],
)
def test_what_is_no_plan_is_refused(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text(text)
    with pytest.raises(ProcedureError, match=said):
        read_plan(file)
