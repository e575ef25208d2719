"""Tools that cut as they move: what the simulation asks for, and what the blade feels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from support.small_block import block_mesh, pose_of
from tissue_sim.frame import Budget, Command, Frame, FrameInputs, ToolSample
from tissue_sim.interaction.cut_response import SLOW, CutResponse, resistance
from tissue_sim.interaction.tools import ToolError, ToolSpec
from tissue_sim.journal import replay
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

SIZE = 0.06
RATE = 60.0
TURN = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
"""The blade stands in a plane x = const, its length along y."""


class Use:
    """A simulation with one knife, moved frame by frame."""

    def __init__(self, **more: Any) -> None:
        response = CutResponse(**more.pop("response", {}))
        self.tool = ToolSpec(
            "knife", "cut", "rectangle", (0.02, 0.04), cutting="progressive", response=response,
            **more,
        ).checked()  # fmt: skip
        self.simulation = Simulation(block_mesh(7), Scene(tools=(self.tool,), rate_hz=RATE))
        self.frames: list[Frame] = []

    def frame(self, place: Any, edge: int = 0, *commands: Command) -> Frame:
        pose = pose_of(place, TURN)
        sample = ToolSample("knife", pose, 1, True, edge)  # type: ignore[arg-type]
        inputs = FrameInputs(commands, (), (sample,))
        self.frames.append(self.simulation.advance(inputs, Budget(steps=3)))
        return self.frames[-1]

    def go(self, start: Any, end: Any, count: int) -> list[Frame]:
        share = np.linspace(0, 1, count)[:, None]
        places = np.asarray(start) * (1 - share) + np.asarray(end) * share
        self.frame(places[0], 1)
        return [self.frame(place) for place in places[1:]]

    def force(self) -> NDArray[np.float64]:
        return self.frames[-1].wrenches.get("knife", np.zeros(6))[:3]


def test_a_stroke_is_numbered_named_and_ended() -> None:
    use = Use()
    use.go([0.03, 0.0, 0.05], [0.03, 0.03, 0.05], 20)
    use.frame([0.03, 0.03, 0.05], -1)
    cuts = [cut for frame in use.frames for cut in frame.cuts]
    assert [cut.strip for cut in cuts] == list(range(len(cuts)))
    assert {cut.stroke for cut in cuts} == {f"{use.simulation.epoch.hex()[:8]}-1-knife"}
    assert [cut.ends for cut in cuts] == [False] * (len(cuts) - 1) + [True]
    use.frame([0.03, 0.03, 0.05], 1)
    (again,) = use.frames[-1].cuts
    assert again.stroke != cuts[0].stroke
    assert again.strip == 0


def test_a_tool_that_cuts_at_use_cuts_once_as_before() -> None:
    use = Use()
    use.simulation.set_tool(replace(use.tool, cutting="at_use"))
    use.go([0.03, 0.0, 0.05], [0.03, 0.03, 0.05], 10)
    (cut,) = [cut for frame in use.frames for cut in frame.cuts]
    assert cut.stroke == ""


def test_a_huge_jump_cuts_nothing_in_between_and_says_so() -> None:
    use = Use()
    use.go([0.03, 0.0, 0.05], [0.03, 0.01, 0.05], 10)
    frame = use.frame([0.03, 0.2, 0.05])
    assert frame.cuts == ()
    assert any("jumped 0.19 m while cutting" in event for event in frame.events)
    after = [use.frame([0.03, 0.2 + 0.001 * k, 0.05]) for k in range(10)]
    for cut in (cut for frame in after for cut in frame.cuts):
        assert cut.vertices[:, 1].min() >= 0.2


@pytest.mark.parametrize(
    "command",
    [
        Command("remove_tool", {"tool": "knife"}),
        Command("set_tool", {"id": "knife", "kind": "cut", "shape": "rectangle",
                             "size": [0.03, 0.04]}),
    ],
)  # fmt: skip
def test_a_tool_changed_or_removed_ends_its_stroke(command: Command) -> None:
    use = Use()
    use.go([0.03, 0.0, 0.05], [0.03, 0.01, 0.05], 10)
    frame = use.frame([0.03, 0.011, 0.05], 0, command)
    (cut,) = frame.cuts
    assert cut.ends
    assert len(cut.triangles) == 0
    assert not use.simulation.blades.strokes


def test_a_blade_pressed_since_before_a_reset_has_to_be_pressed_again() -> None:
    use = Use()
    assert use.frame([0.03, 0.0, 0.05]).cuts == ()
    assert use.frame([0.03, 0.01, 0.05]).cuts == ()
    assert len(use.frame([0.03, 0.01, 0.05], 1).cuts) == 1


def test_set_tool_keeps_how_a_tool_cuts_unless_it_says() -> None:
    use = Use(response={"toughness": 160.0})
    same = {"id": "knife", "kind": "cut", "shape": "rectangle", "size": [0.03, 0.04]}
    use.frame([0.03, 0.0, 0.1], 0, Command("set_tool", same))
    assert use.simulation.tools["knife"].cutting == "progressive"
    assert use.simulation.tools["knife"].response.toughness == 160.0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"cutting": "slowly"}, "at_use, progressive"),
        ({"response": CutResponse(toughness=-1.0)}, "toughness"),
        ({"response": CutResponse(puncture_depth=0.0)}, "puncture_depth"),
        ({"kind": "grab", "shape": "sphere", "size": (0.01,)}, "at_use for kind grab"),
    ],
)
def test_what_a_blade_cannot_be_is_refused(wrong: dict[str, Any], said: str) -> None:
    tool = ToolSpec("knife", "cut", "rectangle", (0.02, 0.04), cutting="progressive")
    with pytest.raises(ToolError, match=said):
        replace(tool, **wrong).checked()


def test_arguments_carry_how_a_blade_cuts() -> None:
    tool = Use(response={"toughness": 160.0, "friction": 2.0}).tool
    assert ToolSpec.from_arguments(tool.as_arguments()) == tool
    with pytest.raises(ToolError, match="softness"):
        ToolSpec.from_arguments({**tool.as_arguments(), "response": {"softness": 1.0}})


# Resistance


def test_the_work_of_resistance_is_toughness_times_the_area_cut() -> None:
    toughness, length, speed = 164.0, 0.02, 0.05
    now = np.array([[0.0, speed / RATE, 0.0]])
    outwards = np.array([[0.0, np.cos(0.5), np.sin(0.5)]])
    felt = resistance(
        CutResponse(toughness=toughness), np.zeros((1, 3)), now, outwards, np.array([length]),
        np.zeros(3), 1.0 / RATE,
    )  # fmt: skip
    area_per_second = length * speed * np.cos(0.5)
    power = -felt[:3] @ np.array([0.0, speed, 0.0])
    assert power == pytest.approx(toughness * area_per_second * speed / (speed + SLOW), rel=1e-9)


def test_a_blade_in_tissue_is_held_back_and_one_outside_is_not() -> None:
    use = Use(response={"toughness": 164.0})
    frames = use.go([0.03, 0.0, 0.045], [0.03, 0.03, 0.045], 30)
    depth = SIZE - 0.025  # from the blade's lower side to the top
    speed = 0.03 / 29 * RATE
    forces = [frame.wrenches["knife"][:3] for frame in frames[5:]]
    for force in forces:
        np.testing.assert_allclose(
            force, [0, -164.0 * depth * speed / (speed + SLOW), 0], rtol=0.25, atol=1e-9
        )
    use.frame([0.03, 0.03, 0.045])
    np.testing.assert_array_equal(use.force(), 0.0)
    outside = Use(response={"toughness": 164.0})
    outside.go([0.03, 0.0, 0.2], [0.03, 0.03, 0.2], 10)
    np.testing.assert_array_equal(outside.force(), 0.0)


def test_friction_holds_back_whichever_way_the_blade_goes() -> None:
    use = Use(response={"friction": 10.0})
    use.go([0.03, 0.01, 0.045], [0.03, 0.03, 0.045], 20)
    forth = use.force()
    for y in np.linspace(0.029, 0.01, 20):
        use.frame([0.03, y, 0.045])
    assert forth[1] < -0.1
    assert use.force()[1] == pytest.approx(-forth[1], rel=0.3)


def test_nothing_is_felt_by_default() -> None:
    use = Use()
    use.go([0.03, 0.0, 0.045], [0.03, 0.03, 0.045], 10)
    assert all(not frame.wrenches for frame in use.frames)


# Before the tissue opens


def test_a_blade_pushes_the_tissue_until_it_gives_way() -> None:
    use = Use(response={"puncture_force": 2.0, "puncture_depth": 0.05})
    felt, opened_at = [], 0
    use.frame([0.03, 0.03, SIZE + 0.03], 1)
    for k in range(1, 80):
        frame = use.frame([0.03, 0.03, SIZE + 0.03 - 0.0005 * k])
        if frame.cuts:
            opened_at = k
            break
        felt.append(float(np.linalg.norm(use.force())))
        pushed = use.simulation.holds.rows
        if len(pushed):
            sunk = use.simulation.state.displacement[pushed, 2]
    assert opened_at > 15
    assert sunk.max() < -5e-4
    assert felt == sorted(felt)
    assert 1.6 < max(felt) < 2.3
    np.testing.assert_array_equal(use.force(), 0.0)
    assert not use.simulation.holds.by_id
    (cut,) = use.frames[-1].cuts
    # All that it has passed since it touched the tissue.
    lowest = SIZE + 0.01 - 0.0005 * opened_at
    assert cut.vertices[:, 2].min() == pytest.approx(lowest, abs=1e-9)
    assert len(cut.triangles) > 2
    more = [use.frame([0.03, 0.03, SIZE + 0.03 - 0.0005 * k]) for k in range(opened_at, 100)]
    assert any(frame.cuts for frame in more)


def test_tissue_does_not_stick_to_a_blade_that_goes_back() -> None:
    use = Use(response={"puncture_force": 100.0, "puncture_depth": 0.05})
    use.frame([0.03, 0.03, SIZE + 0.022], 1)
    for k in range(20):
        use.frame([0.03, 0.03, SIZE + 0.022 - 0.0005 * k])
    assert use.simulation.holds.by_id
    for k in range(60):
        use.frame([0.03, 0.03, SIZE + 0.012 + 0.0005 * k])
    assert not use.simulation.holds.by_id
    assert not any(frame.cuts for frame in use.frames)
    use.frame([0.03, 0.03, SIZE + 0.05], -1)
    assert not use.simulation.blades.strokes


def test_tissue_without_forces_gives_way_at_a_depth() -> None:
    use = Use(response={"puncture_force": 100.0, "puncture_depth": 0.004})
    use.simulation.set_model("relaxation", {}, "")
    use.frame([0.03, 0.03, SIZE + 0.022], 1)
    for k in range(20):
        use.frame([0.03, 0.03, SIZE + 0.022 - 0.0005 * k])
    assert any(frame.cuts for frame in use.frames)


def test_pushing_and_cutting_replay_bit_by_bit() -> None:
    use = Use(response={"puncture_force": 0.3, "toughness": 100.0})
    use.frame([0.03, 0.03, SIZE + 0.03], 1)
    for k in range(40):
        use.frame([0.03, 0.03, SIZE + 0.03 - 0.001 * k])
    again = replay([frame.journal for frame in use.frames], block_mesh(7))
    assert again.mismatches == ()
