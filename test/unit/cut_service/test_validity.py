"""What looks at meshes after random edits notices what is wrong with them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cut_service.trial import Trial, remembered
from cut_service.validity import look_at
from support.cut_scenes import new
from support.sewn_blocks import sew_edit
from support.sheets import connected
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.incidence import Incidence
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import block
from tissue_sim.geometry.sutures import Sutures


def again(mesh: Mesh) -> Mesh:
    """With lists that say what the elements say."""
    rows = mesh.element_rows
    mesh.incident = Incidence.build(mesh.tets[:rows], mesh.element_alive[:rows], mesh.node_capacity)
    return mesh


def inverted() -> Mesh:
    mesh = new("block")
    mesh.tets[5, [0, 1]] = mesh.tets[5, [1, 0]]
    return again(mesh)


def without_element() -> Mesh:
    mesh = new("block")
    mesh.node_alive[mesh.node_rows] = True
    return mesh


def at_an_edge() -> Mesh:
    """Two elements with an edge in common and nothing else."""
    points = np.array(
        [[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], dtype=float
    )
    return Mesh(RawMesh(points, np.array([[0, 2, 3, 1], [0, 4, 5, 1]])))


def three_at_a_face() -> Mesh:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [0.2, 0.2, 2]])
    return Mesh(RawMesh(points, np.array([[0, 1, 2, 3], [0, 2, 1, 4], [0, 1, 2, 5]])))


def other_lists() -> Mesh:
    mesh = new("block")
    mesh.incident.data[int(mesh.incident.start[7])] += 1
    return mesh


def stitched_to_nobody() -> Mesh:
    mesh = new("block")
    one = np.ones(1)
    ids = np.array([1], dtype=np.uint32)
    ends = np.array([[3, mesh.node_rows + 2]], dtype=np.int32)
    mesh.sutures = Sutures(ids, ends, one, one, ids, 2)
    return mesh


def sheet_at_a_node() -> Mesh:
    """Two triangles of one node, and a spring from a node to itself."""
    mesh = connected()
    mesh.tets[0, 1] = mesh.tets[0, 0]
    return again(mesh)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (inverted, "1 elements without positive rest volume"),
        (without_element, "nodes without elements"),
        (at_an_edge, "not connected through faces"),
        (three_at_a_face, "faces in more than two"),
        (other_lists, "lists of elements"),
        (stitched_to_nobody, "a stitch at a node that is no more"),
        (sheet_at_a_node, "triangles without an area"),
    ],
)
def test_each_thing_that_can_be_wrong_is_found(make: Callable[[], Mesh], words: str) -> None:
    assert words in "; ".join(look_at(make()).faults)


@pytest.mark.parametrize("make", [lambda: new("block"), lambda: new("shell"), connected])
def test_an_organ_that_nothing_happened_to_has_no_fault(make: Callable[[], Mesh]) -> None:
    seen = look_at(make())
    assert seen.faults == ()
    assert seen.parts == 1
    assert 0.0 < seen.ratio <= 1.0


def trial() -> Trial:
    return Trial(block(4, 4, 4, 0.03, 0.03, 0.03), None, np.random.default_rng(1))


def test_an_edit_that_does_more_than_it_may_is_noticed() -> None:
    tried = trial()
    mesh = tried.mesh
    inner = int(np.argmin(np.linalg.norm(mesh.rest[: mesh.node_rows] - 0.01, axis=1)))
    # The corner of a block moves: volume is lost, and the node was to stay.
    element = mesh.tets[mesh.incident.of(0)[0]]
    weights = np.where(element == 0, 0.7, 0.1)
    move = TopologyEdit(
        mesh.version, moved_nodes=np.array([0], dtype=np.uint32),
        moved_rest=(weights @ mesh.rest[element])[None],
        moved_anchors=element[None].astype(np.uint32), moved_weights=weights[None],
    )  # fmt: skip
    tried.carry_out("move", move, still=np.array([0, inner]))
    said = "; ".join(tried.faults)
    assert "move changed the rest volume" in said
    assert "moved fixed or held nodes" in said
    # An element comes loose at three of its corners and hangs at one node.
    parents = mesh.tets[30, :3]
    new_ids = PROVISIONAL + np.arange(3)
    loose = TopologyEdit(
        mesh.version, copied_nodes=new_ids.astype(np.uint32),
        copy_parents=parents.astype(np.uint32), rewritten_elements=np.array([30], dtype=np.uint32),
        rewritten_nodes=np.append(new_ids, mesh.tets[30, 3])[None].astype(np.uint32),
    )  # fmt: skip
    tried.carry_out("tear", loose)
    assert "not connected through faces" in tried.faults[-1]


def test_an_undo_that_forgets_something_is_noticed() -> None:
    tried = trial()
    tried.carry_out("sew", sew_edit(tried.mesh, np.array([0]), np.array([9])))
    tried.mesh.rest[5, 1] = np.nextafter(tried.mesh.rest[5, 1], 1.0)
    tried.go_back(1)
    assert "undo of a suture: not as it was before: rest" in tried.faults[0]
    assert remembered(tried.mesh)["stitches"] == remembered(trial().mesh)["stitches"]
