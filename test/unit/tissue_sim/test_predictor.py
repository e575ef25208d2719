"""What a fast model does in a frame is where the precise one starts from."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from support.small_block import CORNER, block_mesh, block_simulation, pose_of, tool_at
from support.split_edit import split_at
from tissue_sim.frame import Budget, Command, FrameInputs, ToolSample
from tissue_sim.journal import replay
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

NONE = Budget(steps=0)
TOOL, OTHER = tool_at(CORNER, "left"), tool_at((0.0, 0.06, 0.06), "right")
PULL = np.array([0.0, 0.004, 0.006])
ALL = {
    "vertex_block_descent": {"levels": 10000},
    "quasi_static": {"levels": 10000, "momentum": 0.9},
}


def grabbed(**scene: Any) -> Simulation:
    simulation = block_simulation(TOOL, **{"parameters": ALL, **scene})
    simulation.advance(FrameInputs((Command("grab", {"tool": "left", "radius": 0.02}),)), NONE)
    return simulation


def moved(simulation: Simulation, share: float, steps: int) -> NDArray[np.float32]:
    pose = np.array(TOOL.pose)
    pose[:3] += share * PULL
    sample = ToolSample("left", pose)
    return simulation.advance(FrameInputs(tools=(sample,)), Budget(steps=steps)).positions.copy()


def test_finite_elements_ahead_leave_vertex_block_descent_less_to_do() -> None:
    error = {}
    for predictor in ("", "finite_element"):
        simulation = grabbed(model="vertex_block_descent", predictor=predictor, predictor_steps=10)
        for frame in range(10):
            near = moved(simulation, (frame + 1) / 10, 2)
        end = moved(simulation, 1.0, 400)
        error[predictor] = float(np.abs(near - end).max())
    assert error["finite_element"] < 0.5 * error[""]


@pytest.mark.parametrize("predictor", ["lr", "finite_element", "chain_mail"])
@pytest.mark.parametrize("model", ["vertex_block_descent", "quasi_static", "finite_element"])
def test_the_end_is_the_precise_model_s(model: str, predictor: str) -> None:
    if model == predictor:
        pytest.skip("no model goes ahead of itself")
    ends = []
    for name in ("", predictor):
        simulation = grabbed(model=model, predictor=name, predictor_steps=2)
        for frame in range(5):
            moved(simulation, (frame + 1) / 5, 3)
        ends.append(moved(simulation, 1.0, 600))
    assert np.abs(ends[0] - ends[1]).max() < 2e-3 * np.linalg.norm(PULL)


def test_while_nothing_held_moves_the_tissue_is_not_moved() -> None:
    simulation = grabbed(model="quasi_static", predictor="lr")
    moved(simulation, 1.0, 3)
    before = simulation.state.displacement.copy()
    ahead = simulation._predictor
    assert ahead is not None
    was = ahead.state.displacement.copy()
    moved(simulation, 1.0, 0)
    np.testing.assert_array_equal(simulation.state.displacement, before)
    assert (ahead.state.displacement != was).any()


def test_what_lies_outside_the_region_is_not_moved() -> None:
    simulation = grabbed(
        model="quasi_static", predictor="finite_element", predictor_steps=20,
        parameters={"quasi_static": {"levels": 2}},
    )  # fmt: skip
    moved(simulation, 1.0, 0)
    moving = (simulation.state.displacement != 0).any(axis=1)
    region = np.zeros_like(moving)
    active = simulation.model.active  # type: ignore[attr-defined]
    region[active.ordering.nodes[: active.end]] = True
    assert (moving & ~simulation.state.prescribed).sum() > 0
    assert not (moving & ~region).any()


@pytest.mark.parametrize("predictor", ["lr", "finite_element"])
def test_a_replay_with_a_predictor_is_bit_exact(predictor: str) -> None:
    simulation = block_simulation(
        TOOL, OTHER, model="vertex_block_descent", predictor=predictor, predictor_steps=3
    )
    random, entries, level = np.random.default_rng(5), [], {"left": False, "right": False}
    places = {"left": np.array(TOOL.pose[:3]), "right": np.array(OTHER.pose[:3])}
    for number in range(40):
        samples = []
        for tool in level:
            places[tool] += random.normal(scale=1e-3, size=3)
            edge: Literal[-1, 0, 1] = 0
            if random.random() < 0.2:
                level[tool] = not level[tool]
                edge = 1 if level[tool] else -1
            samples.append(ToolSample(tool, pose_of(places[tool]), 1, level[tool], edge))
        edits = (split_at(simulation.mesh, 0.03, top=0.05),) if number == 20 else ()
        inputs = FrameInputs(edits=edits, tools=tuple(samples))
        entries.append(simulation.advance(inputs, Budget(steps=2)).journal)
    result = replay(entries, block_mesh())
    assert result.mismatches == ()
    np.testing.assert_array_equal(
        result.simulation.state.displacement, simulation.state.displacement
    )
    alone = replace(simulation.scene, predictor="").as_arguments()
    start = replace(entries[0].inputs.commands[0], arguments=alone)
    entries[0] = replace(entries[0], inputs=replace(entries[0].inputs, commands=(start,)))
    assert replay(entries, block_mesh()).mismatches


def test_another_model_that_takes_no_guess_goes_on_alone() -> None:
    simulation = grabbed(model="quasi_static", predictor="finite_element")
    change = Command("set_model", {"model": "lr", "parameters": {}})
    events = simulation.advance(FrameInputs((change,)), NONE).events
    assert any("takes no prediction" in event for event in events)
    moved(simulation, 0.5, 3)
    assert np.isfinite(simulation.state.displacement).all()


def test_a_start_from_before_there_was_prediction_has_none() -> None:
    arguments = Scene(predictor="lr", predictor_steps=4).as_arguments()
    again = Scene.from_arguments(arguments)
    assert (again.predictor, again.predictor_steps) == ("lr", 4)
    del arguments["predictor"], arguments["predictor_steps"]
    assert Scene.from_arguments(arguments).predictor == ""


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ({"predictor": "fastest"}, r"no predictor 'fastest'; allowed: chain_mail, finite_element"),
        ({"predictor": "spring_mass"}, r"no predictor 'spring_mass'; allowed: chain_mail"),
        ({"predictor": "quasi_static"}, "cannot be its own predictor"),
        ({"predictor": "lr", "predictor_steps": 0}, r"predictor_steps = 0 .* allowed: 1 to 1000"),
        ({"predictor": "quasi_static", "model": "lr"}, "model lr, as it is set, takes no predict"),
        (
            {
                "predictor": "vertex_block_descent",
                "parameters": {"vertex_block_descent": {"dynamic": 1}},
            },
            "goes by time and cannot go ahead; allowed: without dynamic",
        ),
        (
            {
                "predictor": "lr",
                "model": "finite_element",
                "parameters": {"finite_element": {"corotated": 1}},
            },
            "finite_element, as it is set, takes no prediction; allowed with a predictor: quasi",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(scene: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        block_simulation(**{"model": "quasi_static", **scene})
