"""Progressive cuts: strips joined and carried along give the cut that one sweep gives."""

from __future__ import annotations

import asyncio
import copy
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components as components_of
from scipy.spatial import cKDTree

from cut_service.errors import CutCode, CutError
from cut_service.joined_parts import count_parts
from cut_service.outcome import Outcome
from cut_service.planner import plan
from cut_service.sheet_validity import sheet_faults, sheet_joints
from cut_service.stroke_study import as_markdown
from cut_service.strokes import Pick, Strip, Strokes
from cut_service.sweep import Sweep
from cut_service.swept import Swept
from cut_service.work import Settings
from support.operation import Operation, knife, line, split_nodes
from support.sheets import shell
from support.valid_mesh import check_valid
from tissue_sim.frame import Command
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.geometry.sheet_geometry import (
    CONNECTED,
    SURFACE,
    SheetSettings,
    surface_of,
    with_sheet,
)
from tissue_sim.interaction.blade_contact import mean_edge
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.journal import replay
from tissue_sim.replica import Replica

SIZE = 0.06
NODES = 8
TURN = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
"""The blade stands in a plane x = const and its length runs along y."""

PLACE = 0.0303


def organ() -> Mesh:
    raw = block(NODES, NODES, NODES, SIZE, SIZE, SIZE)
    random = np.random.default_rng(5)
    inner = (raw.points > 1e-9) & (raw.points < SIZE - 1e-9)
    shake = inner * random.uniform(-0.2, 0.2, raw.points.shape) * SIZE / NODES
    return Mesh(replace(raw, points=raw.points + shake), raw.points[:, 2] < 1e-9)


def along(y: float) -> NDArray[np.float64]:
    return np.array([0.0, y, 0.0])


def way(depth: float, frames: int, end: float = 0.085) -> list[NDArray[np.float64]]:
    """Along y through the block, the lower side `depth` below its top."""
    z = SIZE - depth + 0.02
    return line([PLACE, -0.02, z], [PLACE, end, z], frames, TURN)


def cut_at_once(mesh: Mesh, depth: float, last: float = 0.085 + 0.01) -> Mesh:
    """The same mesh cut by everything that the blade passes, as one sweep."""
    low, high = SIZE - depth, SIZE - depth + 0.04
    sweep = Sweep.between(
        np.array([[PLACE, -0.03, low], [PLACE, last, low]]),
        np.array([[PLACE, -0.03, high], [PLACE, last, high]]),
    )
    mesh.apply(plan(mesh, mesh.rest[: mesh.node_rows], sweep).edit)
    return mesh


def everywhere() -> Sweep:
    """Right through the block."""
    return Sweep.between(
        np.array([[PLACE, -0.03, -0.1], [PLACE, 0.1, -0.1]]),
        np.array([[PLACE, -0.03, 0.1], [PLACE, 0.1, 0.1]]),
    )


def farthest(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Hausdorff distance of two sets of points."""
    return max(float(np.max(cKDTree(p).query(q)[0])) for p, q in ((a, b), (b, a)))


BLADE = knife((0.02, 0.04))


@pytest.mark.parametrize(("frames", "latency"), [(90, 1), (40, 4), (200, 2)])
def test_strips_open_what_one_sweep_opens(frames: int, latency: int) -> None:
    depth = 0.033
    operation = Operation(organ(), BLADE, latency)
    operation.go(way(depth, frames))
    whole = cut_at_once(organ(), depth)
    edge = mean_edge(whole)
    assert farthest(split_nodes(operation.simulation.mesh), split_nodes(whole)) <= edge
    assert check_valid(operation.simulation.mesh).components == 1
    assert len(operation.edits) >= 4
    by_strip = [edit.request_id.rpartition("/")[0] for edit in operation.edits]
    assert len(set(by_strip)) == 1


@pytest.mark.parametrize("frames", [40, 100, 250])
def test_a_stroke_right_through_gives_two_parts(frames: int) -> None:
    operation = Operation(organ(), knife((0.02, 0.09)), 2)
    operation.go(line([PLACE, -0.02, 0.03], [PLACE, 0.085, 0.03], frames, TURN))
    assert check_valid(operation.simulation.mesh).components == 2


@pytest.mark.parametrize("method", ["subdivide", "remove"])
def test_other_ways_of_cutting_follow_a_stroke(method: str) -> None:
    operation = Operation(organ(), knife((0.02, 0.09)), 2, method)
    operation.go(line([PLACE, -0.02, 0.03], [PLACE, 0.085, 0.03], 80, TURN))
    assert check_valid(operation.simulation.mesh).components == 2


def springs_across(mesh: Mesh, place: float) -> int:
    """Springs from triangles on one side of x = place to triangles on the other."""
    sheet = mesh.sheet
    assert sheet is not None
    first, second = sheet.triangles[:, [0, 1]].ravel(), sheet.triangles[:, [1, 2]].ravel()
    graph = coo_matrix((np.ones(len(first)), (first, second)), (mesh.node_rows, mesh.node_rows))
    label = components_of(graph, directed=False)[1]
    size = np.bincount(label)
    middle = np.bincount(label, mesh.rest[: mesh.node_rows, 0]) / size
    side = middle[label] > place
    return int((side[sheet.springs[:, 0]] != side[sheet.springs[:, 1]]).sum())


@pytest.mark.parametrize(
    ("shape", "kind", "place", "latency"),
    [
        ("block", SURFACE, PLACE, 2),
        ("block", CONNECTED, PLACE, 2),
        ("block", CONNECTED, 0.027, 3),
        ("shell", CONNECTED, 0.0, 2),
        ("shell", CONNECTED, -0.003, 2),
        ("shell", CONNECTED, 0.004, 4),
    ],
)
def test_a_stroke_right_through_surfaces_gives_two_parts(
    shape: str, kind: str, place: float, latency: int
) -> None:
    surface = shell() if shape == "shell" else surface_of(block(8, 8, 8, SIZE, SIZE, SIZE))
    mesh = Mesh(with_sheet(surface, SheetSettings(kind), []))
    middle = 0.0 if shape == "shell" else 0.03
    operation = Operation(mesh, knife((0.02, 0.12)), latency)
    start, end = ([place, middle + y, middle] for y in (-0.06, 0.06))
    operation.go(line(start, end, 80, TURN))
    mesh = operation.simulation.mesh
    assert len(operation.edits) > 3
    assert springs_across(mesh, place) == 0
    assert count_parts(*sheet_joints(mesh)) == 2
    assert sheet_faults(mesh) == []


def test_tissue_that_is_pulled_while_it_is_cut_is_cut_once() -> None:
    operation = Operation(organ(), BLADE, 2)
    simulation = operation.simulation
    simulation.set_tool(
        ToolSpec("grasper", size=(0.02,), pose=(SIZE, SIZE / 2, SIZE, 0, 0, 0, 1)).checked()
    )
    poses = way(0.033, 80)
    grab = Command("grab", {"tool": "grasper", "radius": 0.02})
    operation.frame(poses[0], use=False, commands=(grab,))
    operation.frame(poses[0], edge=1)
    for number, pose in enumerate(poses[1:]):
        simulation.poses["grasper"][0] = SIZE + 0.03 * number / len(poses)
        operation.frame(pose)
    operation.frame(poses[-1], use=False, edge=-1)
    for _ in range(9):
        operation.frame(poses[-1], use=False)
    assert check_valid(simulation.mesh).components == 1
    still = cut_at_once(organ(), 0.033)
    opened = split_nodes(simulation.mesh)
    assert len(opened) <= 1.3 * len(split_nodes(still))
    assert opened[:, 1].max() > SIZE - mean_edge(still)


def test_a_stroke_that_ends_inside_keeps_its_rim() -> None:
    operation = Operation(organ(), BLADE, 2)
    operation.go(way(0.033, 50, end=0.02))
    whole = cut_at_once(organ(), 0.033, last=0.03)
    opened = split_nodes(operation.simulation.mesh)
    assert farthest(opened, split_nodes(whole)) <= mean_edge(whole)
    assert opened[:, 1].max() <= 0.03 + mean_edge(whole)
    assert check_valid(operation.simulation.mesh).components == 1


def test_tissue_opens_behind_the_blade_while_it_moves() -> None:
    operation = Operation(organ(), BLADE, 2)
    poses = way(0.033, 80)
    operation.frame(poses[0], edge=1)
    edge = mean_edge(operation.first)
    behind = []
    for pose in poses[1:]:
        operation.frame(pose)
        front = pose[1] + 0.01
        if edge < front < SIZE and len(split_nodes(operation.simulation.mesh)):
            behind.append(front - split_nodes(operation.simulation.mesh)[:, 1].max())
    assert len(behind) > 20
    # Two edges of the mesh, and what the blade goes while an edit is planned.
    assert max(behind) <= 2 * edge + 5 * np.linalg.norm(poses[1][:3] - poses[0][:3])


@settings(deadline=None, max_examples=6)
@given(st.integers(0, 10**6))
def test_tremor_pauses_and_turns_leave_a_valid_mesh(seed: int) -> None:
    random = np.random.default_rng(seed)
    operation = Operation(organ(), BLADE, int(random.integers(1, 5)))
    place, heading = np.array([PLACE, -0.015, SIZE - 0.01]), np.pi / 2
    poses = []
    for _ in range(60):
        heading += random.normal(scale=0.04)
        step = random.choice([0.0, 0.001, 0.003])
        place = place + step * np.array([np.cos(heading), np.sin(heading), 0.0])
        place = place + random.normal(scale=2e-4, size=3)
        poses.append(np.array([*place, 0, 0, np.sin(heading / 2), np.cos(heading / 2)]))
    operation.go(poses)
    check_valid(operation.simulation.mesh)
    assert operation.edits


def test_a_replay_of_a_stroke_is_bit_exact() -> None:
    operation = Operation(organ(), BLADE, 3)
    operation.go(way(0.033, 50))
    again = replay(operation.entries, operation.first)
    assert again.mismatches == ()
    assert again.simulation.mesh.version == operation.simulation.mesh.version > 4
    cuts = sum(cut.stroke != "" for cut in operation.cuts)
    assert cuts == len(operation.cuts) > 10


def test_strips_too_narrow_to_part_anything_add_up() -> None:
    """A twelfth of an edge at a time, straight to the planner's side."""
    mesh = organ()
    edge = mean_edge(mesh)
    swept = Swept(3 * edge)
    side = np.array([[PLACE, -0.005, SIZE - 0.033], [PLACE, -0.005, SIZE + 0.005]])
    parted = missed = 0
    step = np.array([0.0, edge / 12, 0.0])
    for k in range(int((SIZE + 0.01) / step[1])):
        before, after = side + k * step, side + (k + 1) * step
        swept.add(np.concatenate([before, after]), [[0, 1, 2], [1, 3, 2]])
        shape = mesh.rest[: mesh.node_rows]
        swept.carry(shape, mesh.node_alive)
        made = None
        try:
            made = plan(mesh, shape, swept.sweep())
            mesh.apply(made.edit)
            parted += 1
        except CutError as error:
            missed += error.code == CutCode.MISSED
        swept.planned(mesh.rest[: mesh.node_rows], mesh.node_alive, made)
    whole = cut_at_once(organ(), 0.033)
    assert parted >= 5
    assert missed > parted
    assert parted + missed == int((SIZE + 0.01) / step[1])
    assert farthest(split_nodes(mesh), split_nodes(whole)) <= edge


def test_the_documented_figures_are_those_of_the_study(repository: Path) -> None:
    rows = json.loads((repository / "docs/results/strokes.json").read_text())["rows"]
    assert as_markdown(rows) in (repository / "docs/progressive_cutting.md").read_text()
    heart, small, large = rows
    assert heart["nodes"] > 36000
    assert heart["plan_ms"]["median"] < 1000 / 60
    assert heart["edit_ms"]["median"] < 2.0
    assert small["faces"] == large["faces"]


# The surface that was passed


def test_a_surface_that_was_planned_with_moves_with_the_tissue() -> None:
    mesh = organ()
    shape = mesh.rest[: mesh.node_rows].copy()
    swept = Swept(0.02)
    first = np.array(
        [[0.03, 0.02, 0.02], [0.03, 0.02, 0.05], [0.03, 0.03, 0.02], [0.03, 0.03, 0.05]]
    )
    swept.add(first, [[0, 1, 2], [1, 3, 2]])
    swept.planned(shape, mesh.node_alive, plan(mesh, shape, everywhere()))
    gone = np.array([0.01, -0.02, 0.005])
    swept.carry(shape + gone, mesh.node_alive)
    np.testing.assert_allclose(swept.points, first + gone, atol=1e-12)
    second = first + along(0.01)
    swept.add(second, [[0, 1, 2], [1, 3, 2]])
    # It goes on from where the tissue has taken the edge.
    assert len(swept.points) == 6
    np.testing.assert_allclose(swept.points[:4], first + gone, atol=1e-12)
    np.testing.assert_array_equal(swept.points[4:], second[2:])
    assert len(swept.sweep().triangles) == 4


def test_strips_far_away_are_not_planned_with_again() -> None:
    swept = Swept(0.004)
    mesh = organ()
    side = np.array([[0.03, 0.0, 0.02], [0.03, 0.0, 0.05]])
    for k in range(40):
        before, after = side + along(0.001 * k), side + along(0.001 * (k + 1))
        swept.add(np.concatenate([before, after]), [[0, 1, 2], [1, 3, 2]])
        count = len(swept.sweep().triangles)
        made = plan(mesh, mesh.rest[: mesh.node_rows], everywhere())
        swept.planned(mesh.rest[: mesh.node_rows], mesh.node_alive, made)
    assert 8 <= count <= 12


# Taking turns


class FakeService:
    """Plans whatever is picked, taking a few turns of the loop over it."""

    def __init__(self, mesh: Mesh) -> None:
        self.replica = Replica()
        self.replica.take_keyframe(b"epoch", mesh)
        self.rest = mesh.rest[: mesh.node_rows].astype(np.float32)
        self.replica.take_state(b"epoch", mesh.version, 1, self.rest)
        self.asked: list[tuple[str, str, int]] = []
        self.busy = 0
        self.said: list[str] = []
        self.strokes = Strokes(self.replica, Settings(), self.said.append)

    async def cut(self, pick: Pick, frame: int, epoch: bytes, tool: str, request: str) -> Outcome:
        assert not self.busy
        self.busy += 1
        mesh, shape = self.replica.mesh, self.replica.shape_at()
        assert mesh is not None
        assert shape is not None
        sweep, _ = pick(mesh, shape)
        self.asked.append((tool, request, len(sweep.triangles)))
        for _ in range(5):
            await asyncio.sleep(0)
        self.busy -= 1
        return Outcome(CutCode.MISSED, "nothing")

    async def take(self, *strips: Strip) -> None:
        await asyncio.gather(*(self.strokes.take(strip, self.cut) for strip in strips))


def strip(number: int, tool: str = "knife", ends: bool = False, **more: object) -> Strip:
    side = np.array([[0.03, 0.0, 0.02], [0.03, 0.0, 0.05]])
    corners = np.concatenate([side + along(1e-3 * number), side + along(1e-3 * (number + 1))])
    triangles = np.array([[0, 1, 2], [1, 3, 2]], dtype=np.uint32)
    made = Strip(f"{tool}-1", number, ends, tool, b"epoch", 1, corners, triangles)
    return Strip(**{**made.__dict__, **more})


def test_strips_that_come_while_one_is_planned_are_planned_together() -> None:
    service = FakeService(organ())
    asyncio.run(service.take(*(strip(k, ends=k == 9) for k in range(10))))
    assert [request for _, request, _ in service.asked] == ["knife-1/1"] * 2
    assert [count for _, _, count in service.asked] == [2, 20]
    assert service.strokes.finished == 1
    assert "10 strips in 2 plans" in service.said[-1]


def test_two_tools_take_turns_and_a_repeat_counts_once() -> None:
    service = FakeService(organ())
    several = [strip(k, tool) for k in range(3) for tool in ("a", "b")]
    asyncio.run(service.take(*several, several[0]))
    assert [tool for tool, _, _ in service.asked] == ["a", "b", "a"]
    asyncio.run(service.take(strip(3, "a", ends=True), strip(3, "b", ends=True)))
    assert service.strokes.finished == 2


def test_a_strip_that_is_no_surface_is_left_out_with_a_word() -> None:
    service = FakeService(organ())
    broken = strip(1, vertices=np.full((4, 3), np.nan))
    asyncio.run(service.take(strip(0), broken, strip(2, ends=True)))
    assert any("left out" in said and "not finite" in said for said in service.said)
    assert service.strokes.finished == 1


def test_strips_that_were_lost_are_counted() -> None:
    service = FakeService(organ())
    asyncio.run(service.take(strip(0), strip(4, ends=True)))
    assert "3 strips were lost on the way" in service.said[-1]


def test_a_restart_ends_the_strokes_of_the_old_epoch() -> None:
    service = FakeService(organ())
    asyncio.run(service.take(strip(0), strip(1)))
    service.replica.take_keyframe(b"other", copy.deepcopy(organ()))
    service.replica.take_state(b"other", 1, 1, service.rest)
    asyncio.run(service.take(strip(0, epoch=b"other", stroke="knife-2", ends=True)))
    assert any("ended with its epoch" in said for said in service.said)
    assert service.asked[-1][1] == "knife-2/1"


def test_a_stroke_that_never_touches_tissue_says_nothing_was_parted() -> None:
    operation = Operation(organ(), BLADE, 1)
    operation.go(line([0.2, 0, 0], [0.2, 0.03, 0], 20, TURN))
    assert operation.edits == []
    assert operation.empty_seconds
