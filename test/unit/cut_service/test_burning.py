from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from cut_service.burn_strokes import BurnStrokes
from cut_service.burning import (
    BurnError,
    Burns,
    BurnSettings,
    Touch,
    peak_density,
    plan_burn,
)
from cut_service.errors import CutCode, CutError
from cut_service.planner import plan
from cut_service.unswept import work_without_sweep
from support.cut_scenes import SIDE, middle, new, rest, square
from support.small_block import CORNER, block_simulation, pose_of, tool_at
from support.valid_mesh import check_valid
from tissue_sim.frame import Budget, FrameInputs, ToolSample
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.interaction.tools import ToolError, ToolSpec

HOW = BurnSettings(power=30.0, energy_density=2.4e9)
EPOCH = bytes(16)


def test_all_of_the_power_goes_into_the_ball() -> None:
    radius, power = 0.003, 25.0
    peak = peak_density(power, radius)
    found, _ = quad(lambda r: 4 * math.pi * r**2 * peak * (1 - (r / radius) ** 2), 0, radius)
    assert found == pytest.approx(power, rel=1e-12)


def test_a_tool_that_stands_still_burns_the_ball_of_the_closed_form() -> None:
    """Gone is what is nearer than R sqrt(1 - H / (q t)): its volume, and nothing else."""
    mesh = Mesh(block(17, 17, 17, SIDE, SIDE, SIDE))
    before = check_valid(mesh)
    radius, seconds = 0.02, 2400.0
    tip = middle(mesh)
    touches = [Touch(tip, radius, seconds / 10)] * 10
    gone = Burns().heat(mesh, rest(mesh), touches, HOW)
    share = 1.0 - HOW.energy_density / (peak_density(HOW.power, radius) * seconds)
    assert 0.3 < share < 0.9
    reach = radius * math.sqrt(share)
    centroids = rest(mesh)[mesh.tets[: mesh.element_rows]].mean(axis=1)
    inside = np.linalg.norm(centroids - tip, axis=1) <= reach
    np.testing.assert_array_equal(gone, np.flatnonzero(inside))
    mesh.apply(plan_burn(work_without_sweep(mesh, rest(mesh)), gone))
    after = check_valid(mesh)
    assert before.volume - after.volume == pytest.approx(4 / 3 * math.pi * reach**3, rel=0.05)
    assert after.components == 1


def test_burning_along_a_path_keeps_the_mesh_valid_and_undo_brings_all_back() -> None:
    mesh, history = new("shaken"), EditHistory()
    first = mesh.tets[: mesh.element_rows].copy()
    nodes, elements = mesh.node_rows, mesh.element_rows
    burns = Burns()
    random = np.random.default_rng(3)
    made = 0
    for _ in range(25):
        tip = random.uniform(rest(mesh).min(axis=0), rest(mesh).max(axis=0))
        gone = burns.heat(mesh, rest(mesh), [Touch(tip, 0.012, 300.0)], HOW)
        if not len(gone):
            continue
        change = mesh.apply(plan_burn(work_without_sweep(mesh, rest(mesh)), gone))
        history.record(change)
        burns.follow(mesh, change)
        check_valid(mesh)
        made += 1
    assert made > 10
    for _ in range(made):
        change = mesh.apply(history.undo(mesh, "", ""))
        history.record(change)
        burns.follow(mesh, change)
    assert mesh.element_alive[:elements].all()
    assert mesh.node_alive[:nodes].all()
    assert not mesh.node_alive[nodes : mesh.node_rows].any()
    np.testing.assert_array_equal(mesh.tets[:elements], first)
    # What came back is cold: it is not gone at once when a tool comes near it again.
    assert not len(burns.heat(mesh, rest(mesh), [Touch(middle(mesh), 0.05, 1e-9)], HOW))


def test_parts_of_a_hot_element_are_as_hot() -> None:
    mesh, burns = new("block"), Burns()
    half = BurnSettings(power=30.0, energy_density=1e15)
    burns.heat(mesh, rest(mesh), [Touch(middle(mesh), 0.04, 10.0)], half)
    before = burns.energy.copy()
    sweep = square(np.add(middle(mesh), [0.001, 0.0, 0.0]), np.array([1.0, 0.2, 0.1]), 0.5)
    change = mesh.apply(plan(mesh, rest(mesh), sweep, "subdivide").edit)
    burns.follow(mesh, change)
    added = mesh.element_rows_of(change.edit.added_elements)
    np.testing.assert_array_equal(burns.energy[added], before[change.edit.added_parents])


def test_what_burns_is_pressed_followed_and_of_this_epoch() -> None:
    strokes = BurnStrokes()
    strokes.set_tools({"hook": 0.002, "none": 0.0}, set())
    tip = np.array([0.01, 0.0, 0.0])
    strokes.advance(EPOCH, 0.0)
    strokes.move("hook", tip)
    strokes.advance(EPOCH, 0.02)
    assert not strokes.taken(EPOCH), "not pressed"
    strokes.set_tools({"hook": 0.002, "none": 0.0}, {"hook", "none", "unknown"})
    strokes.move("hook", np.array([np.nan, 0.0, 0.0]))
    strokes.advance(EPOCH, 0.04)
    (touch,) = strokes.taken(EPOCH)
    assert touch.radius == 0.002
    assert touch.seconds == pytest.approx(0.02)
    np.testing.assert_array_equal(touch.tip, tip)
    strokes.move("hook", np.add(tip, [0.01, 0.0, 0.0]))
    strokes.advance(EPOCH, 0.06)
    way = strokes.taken(EPOCH)
    assert len(way) == 10
    assert sum(touch.seconds for touch in way) == pytest.approx(0.02)
    strokes.advance(EPOCH, 0.06)
    assert not strokes.taken(EPOCH), "paused"
    strokes.advance(EPOCH, 10.0)
    assert not strokes.taken(EPOCH), "states were missed"
    strokes.set_tools({"hook": 0.002}, set())
    strokes.advance(EPOCH, 10.02)
    assert not strokes.taken(EPOCH), "released, or frozen"
    strokes.set_tools({"hook": 0.002}, {"hook"})
    strokes.advance(EPOCH, 10.04)
    strokes.advance(bytes(15) + b"x", 0.02)
    assert not strokes.taken(EPOCH), "another epoch"


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf, 100.0])
def test_a_radius_that_makes_no_sense_is_refused(radius: float) -> None:
    with pytest.raises(BurnError, match=r"radius .* is not allowed; allowed: 1e-06 to 10 m"):
        Touch(np.zeros(3), radius, 1.0)


def test_powers_times_and_places_that_make_no_sense_are_refused() -> None:
    with pytest.raises(BurnError, match=r"power = -1 is not allowed"):
        BurnSettings(power=-1.0)
    with pytest.raises(BurnError, match=r"energy_density = 0 is not allowed"):
        BurnSettings(energy_density=0.0)
    with pytest.raises(BurnError, match="burns for -1 s"):
        Touch(np.zeros(3), 0.01, -1.0)
    with pytest.raises(BurnError, match="not finite"):
        Touch(np.array([0.0, np.nan, 0.0]), 0.01, 1.0)


def test_burning_nothing_or_everything_is_refused() -> None:
    mesh = new("block")
    work = work_without_sweep(mesh, rest(mesh))
    with pytest.raises(CutError, match="nothing has burned") as nothing:
        plan_burn(work, np.empty(0, dtype=np.int32))
    assert nothing.value.code == CutCode.MISSED
    with pytest.raises(CutError, match="would leave no tissue") as everything:
        plan_burn(work, np.arange(mesh.element_rows, dtype=np.int32))
    assert everything.value.code == CutCode.REFUSED


def test_a_burning_tool_that_is_pressed_neither_holds_nor_cuts() -> None:
    simulation = block_simulation(tool_at(CORNER, "hook", kind="burn", size=(0.03,)))
    pressed = ToolSample("hook", pose_of(CORNER), 1, True, 1)
    frame = simulation.advance(FrameInputs(tools=(pressed,)), Budget(steps=1))
    assert (frame.cuts, frame.events, len(simulation.holds)) == ((), (), 0)


@pytest.mark.parametrize("radius", [0.0, -0.1, np.nan])
def test_a_burning_tool_needs_a_radius(radius: float) -> None:
    with pytest.raises(ToolError, match=r"size .* is not allowed"):
        ToolSpec("hook", kind="burn", size=(radius,)).checked()
