"""Requests that cannot be met, and the error code that each is refused with.

docs/cutting.md shows these tables (`as_markdown`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from tissue_interfaces.srv import AddPatch, Closure, Cut, Suture

from support.fake_simulation import FRAME
from support.sewn_blocks import SIZE
from support.split_edit import split_at
from tissue_sim.geometry.edit import UNDO, TopologyEdit
from tissue_sim.geometry.mesh import Mesh

GAP = 0.001
MIDDLE = np.array([0.5 * SIZE, 0.0045, 0.003])
"""Of the first block."""

FAR_FRAME = 10**9


def square(half: float, centre: Any = MIDDLE) -> tuple[list[list[float]], list[list[int]]]:
    """A square across the first block, through all of it if it is large."""
    x, y, z = (float(value) for value in centre)
    corners = [[x, y - half, z - half], [x, y + half, z - half], [x, y + half, z + half],
               [x, y - half, z + half]]  # fmt: skip
    return corners, [[0, 1, 2], [0, 2, 3]]


def slices() -> tuple[list[list[float]], list[list[int]]]:
    """Planes so close to each other that they cross every element."""
    corners: list[list[float]] = []
    triangles = []
    for x in np.arange(-0.0005, 2.2 * SIZE, 0.001):
        first = len(corners)
        corners += square(0.05, (x, 0.0, 0.0))[0]
        triangles += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
    return corners, triangles


def cut(vertices: Any = None, triangles: Any = None, **more: Any) -> Cut.Request:
    usual, corners = square(0.05)
    request = Cut.Request(method=more.pop("method", ""))
    request.sweep.header.frame_id = more.pop("frame", FRAME)
    request.sweep.state_frame = more.pop("state_frame", 0)
    points = np.ravel(usual if vertices is None else vertices)
    numbers = np.ravel(corners if triangles is None else triangles)
    request.sweep.vertices = [float(value) for value in points]
    request.sweep.triangles = [int(value) for value in numbers]
    assert not more
    return request


def with_value(value: float) -> list[list[float]]:
    corners = square(0.05)[0]
    corners[1][2] = value
    return corners


CUTS: dict[str, tuple[str, Callable[[], Cut.Request]]] = {
    "a vertex is not a number": ("INVALID_SWEEP", lambda: cut(with_value(np.nan))),
    "a vertex is infinite": ("INVALID_SWEEP", lambda: cut(with_value(np.inf))),
    "a vertex is beyond all numbers": ("INVALID_SWEEP", lambda: cut(with_value(1e200))),
    "two numbers are no vertex": ("INVALID_SWEEP", lambda: cut([1.0, 2.0], [0, 0, 0])),
    "no triangle": ("INVALID_SWEEP", lambda: cut(triangles=[])),
    "no such vertex": ("INVALID_SWEEP", lambda: cut(triangles=[0, 1, 9])),
    "no area": ("INVALID_SWEEP", lambda: cut(triangles=[0, 1, 1])),
    "all at one place": ("INVALID_SWEEP", lambda: cut([MIDDLE] * 3, [0, 1, 2])),
    "too many triangles": ("INVALID_SWEEP", lambda: cut(triangles=[0, 1, 2] * 2001)),
    "enormous": ("INVALID_SWEEP", lambda: cut(square(1e3)[0])),
    "an unknown frame": ("UNKNOWN_FRAME", lambda: cut(frame="moon")),
    "an unknown method": ("UNKNOWN_METHOD", lambda: cut(method="melt")),
    "beside the tissue": ("MISSED", lambda: cut(square(0.01, MIDDLE + 1.0)[0])),
    "a scratch": ("MISSED", lambda: cut(square(1e-4, (0.0, 0.0, 0.0))[0])),
    "a frame to come": ("STATE_FRAME_GONE", lambda: cut(state_frame=FAR_FRAME)),
    "a frame long gone": ("STATE_FRAME_GONE", lambda: cut(state_frame=1)),
    "nothing would be left": ("REFUSED", lambda: cut(*slices(), method="remove")),
}


def suture(action: int = Suture.Request.SEW, **more: Any) -> Suture.Request:
    request = Suture.Request(action=action)
    request.header.frame_id = more.pop("frame", FRAME)
    usual = [[SIZE, 0.0, 0.006], [SIZE + GAP, 0.0, 0.006]] if action == Suture.Request.SEW else []
    points = more.pop("positions", usual)
    request.positions = [float(value) for value in np.ravel(points)]
    for name, value in more.items():
        setattr(request, name, value)
    return request


TIGHTEN, REMOVE, LIST, SEW_RIM = (
    Suture.Request.TIGHTEN, Suture.Request.REMOVE, Suture.Request.LIST, Suture.Request.SEW_RIM
)  # fmt: skip
AWAY = [[1.0, 1.0, 1.0], [1.0, 1.1, 1.0]]
SUTURES: dict[str, tuple[str, Callable[[], Suture.Request]]] = {
    "a position is not a number": ("INVALID", lambda: suture(positions=[[np.nan] * 3] * 2)),
    "one position": ("INVALID", lambda: suture(positions=[[0.0, 0.0, 0.0]])),
    "no position": ("INVALID", lambda: suture(positions=[])),
    "four numbers": ("INVALID", lambda: suture(positions=[0.0, 0.0, 0.0, 0.0])),
    "a spacing that is not a number": ("INVALID", lambda: suture(spacing=np.nan)),
    "a negative spacing": ("INVALID", lambda: suture(spacing=-0.001)),
    "a reach of a metre": ("INVALID", lambda: suture(reach=1.0)),
    "an infinite stiffness": ("INVALID", lambda: suture(stiffness=np.inf)),
    "a stiffness beyond all thread": ("INVALID", lambda: suture(stiffness=1e9)),
    "a length of 99 m": ("INVALID", lambda: suture(length=99.0)),
    "too many stitches": ("INVALID", lambda: suture(
        positions=[[SIZE, 0, 0.006], [SIZE, 0.009, 0.006]] * 2, spacing=1e-6
    )),
    "an unknown action": ("INVALID", lambda: suture(77)),
    "an unknown frame": ("UNKNOWN_FRAME", lambda: suture(frame="moon")),
    "a frame to come": ("STATE_FRAME_GONE", lambda: suture(state_frame=FAR_FRAME)),
    "to nothing": ("NOTHING_THERE", lambda: suture(positions=AWAY)),
    "from a node to itself": ("NOTHING_THERE", lambda: suture(
        positions=[[SIZE, 0.0, 0.006]] * 2, reach=2e-4
    )),
    "tighten an unknown stitch": ("UNKNOWN_SUTURE", lambda: suture(TIGHTEN, sutures=[99])),
    "tighten an unknown thread": ("UNKNOWN_SUTURE", lambda: suture(TIGHTEN, group=99)),
    "tighten to what is no number": ("INVALID", lambda: suture(TIGHTEN, length=np.nan)),
    "tighten to 99 m": ("INVALID", lambda: suture(TIGHTEN, length=99.0)),
    "take out an unknown stitch": ("UNKNOWN_SUTURE", lambda: suture(REMOVE, sutures=[1, 99])),
    "list an unknown stitch": ("UNKNOWN_SUTURE", lambda: suture(LIST, sutures=[99])),
    "sew in an unknown patch": ("UNKNOWN_PATCH", lambda: suture(SEW_RIM, patch=5, spacing=0.002)),
    "sew in a patch where there is none": ("UNKNOWN_PATCH", lambda: suture(
        SEW_RIM, spacing=0.002
    )),
}  # fmt: skip

WITH_PATCHES: dict[str, tuple[str, Callable[[], Suture.Request]]] = {
    "sew in one of two patches, and none is named": ("UNKNOWN_PATCH", lambda: suture(
        SEW_RIM, spacing=0.002
    )),
    "sew in around an unknown hole": ("UNKNOWN_HOLE", lambda: suture(
        SEW_RIM, patch=1, hole="nowhere", spacing=0.002
    )),
    "sew in a patch of which nothing is left": ("NO_RIM", lambda: suture(
        SEW_RIM, patch=2, spacing=0.002
    )),
}  # fmt: skip
"""Asked when the organ has two patches, and nothing is left of the second."""

SHEET = [[0.0, 0.0, 0.01], [0.01, 0.0, 0.01], [0.01, 0.01, 0.01], [0.0, 0.01, 0.01]]


def patch(corners: Any = None, **more: Any) -> AddPatch.Request:
    request = AddPatch.Request()
    request.header.frame_id = more.pop("frame", FRAME)
    points = np.ravel(SHEET if corners is None else corners)
    request.corners = [float(value) for value in points]
    for name, value in more.items():
        setattr(request, name, value)
    return request


PATCHES: dict[str, tuple[str, Callable[[], AddPatch.Request]]] = {
    "a corner is not a number": ("INVALID", lambda: patch([[np.nan] * 3, *SHEET[1:]])),
    "two corners": ("INVALID", lambda: patch(SHEET[:2])),
    "no corner": ("INVALID", lambda: patch([])),
    "corners in a line": ("INVALID", lambda: patch([[0, 0, 0], [0.01, 0, 0], [0.02, 0, 0]])),
    "an outline and corners": ("INVALID", lambda: patch(outline=[0.0, 0.0])),
    "a negative thickness": ("INVALID", lambda: patch(thickness=-1e-3)),
    "an infinite modulus": ("INVALID", lambda: patch(young_modulus=np.inf)),
    "a density that is no number": ("INVALID", lambda: patch(density=np.nan)),
    "a kilometre away": ("INVALID", lambda: patch(np.array(SHEET) + 1e3)),
    "beyond all numbers": ("INVALID", lambda: patch(np.array(SHEET) + 1e200)),
    "thicker than it is wide": ("INVALID", lambda: patch(thickness=0.02)),
    "edges of a kilometre": ("INVALID", lambda: patch(edge_length=1e3)),
    "crosses itself": ("CROSSES", lambda: patch([SHEET[0], SHEET[2], SHEET[1], SHEET[3]])),
    "not flat": ("NOT_FLAT", lambda: patch([*SHEET[:3], [0.0, 0.01, 0.02]])),
    "too many nodes": ("TOO_LARGE", lambda: patch(edge_length=5e-5)),
    "an unknown frame": ("UNKNOWN_FRAME", lambda: patch(frame="moon")),
    "an unknown tool": ("UNKNOWN_TOOL", lambda: patch(tool="nobody")),
    "a frame to come": ("STATE_FRAME_GONE", lambda: patch(state_frame=FAR_FRAME)),
}


def closure(positions: Any = (), **more: Any) -> Closure.Request:
    request = Closure.Request(name=more.pop("name", "hole"))
    request.header.frame_id = more.pop("frame", FRAME)
    request.positions = [float(value) for value in np.ravel(positions)]
    for name, value in more.items():
        setattr(request, name, value)
    return request


RING = [[0.0, 0.0, 0.006], [SIZE, 0.0, 0.006], [SIZE, 0.009, 0.006], [0.0, 0.009, 0.006]]
CLOSURES: dict[str, tuple[str, Callable[[], Closure.Request]]] = {
    "a position is not a number": ("INVALID", lambda: closure([[np.nan] * 3, *RING[1:]])),
    "two positions": ("INVALID", lambda: closure(RING[:2])),
    "four numbers": ("INVALID", lambda: closure([0.0] * 4)),
    "a position beyond all numbers": ("INVALID", lambda: closure([*RING[1:], [1e200] * 3])),
    "a loop like an eight": ("INVALID", lambda: closure([RING[k] for k in (0, 2, 1, 3)])),
    "an unknown frame": ("UNKNOWN_FRAME", lambda: closure(RING, frame="moon")),
    "a frame to come": ("STATE_FRAME_GONE", lambda: closure(RING, state_frame=FAR_FRAME)),
    "around nothing": ("NOTHING_THERE", lambda: closure(np.array(RING) + 1.0)),
    "an unknown hole": ("UNKNOWN_HOLE", lambda: closure(name="nowhere")),
}

SERVICES: dict[str, tuple[type, dict[str, tuple[str, Callable[[], Any]]]]] = {
    "tissue/cut": (Cut, CUTS),
    "tissue/suture": (Suture, SUTURES),
    "tissue/add_patch": (AddPatch, PATCHES),
    "tissue/closure": (Closure, CLOSURES),
}


def _moved(mesh: Mesh, node: int, place: list[float]) -> TopologyEdit:
    return TopologyEdit(
        mesh.version, moved_nodes=np.array([node], dtype=np.uint32), moved_rest=np.array([place]),
        moved_anchors=np.full((1, 4), node, dtype=np.uint32),
        moved_weights=np.array([[1.0, 0.0, 0.0, 0.0]]),
    )  # fmt: skip


def _sewn(mesh: Mesh, one: int, other: int, length: float = 0.0) -> TopologyEdit:
    first = np.array([1 << 31], dtype=np.uint32)
    return TopologyEdit(
        mesh.version, kind="suture", added_sutures=first,
        suture_nodes=np.array([[one, other]], dtype=np.uint32), suture_lengths=np.array([length]),
        suture_stiffness=np.array([100.0]), suture_groups=first,
    )  # fmt: skip


def _removed(mesh: Mesh, element: int) -> TopologyEdit:
    return TopologyEdit(mesh.version, removed_elements=np.array([element], dtype=np.uint32))


UNKNOWN = 99999
"""Id of no node and no element."""

EDITS: dict[str, tuple[str, Callable[[Mesh], TopologyEdit]]] = {
    "planned on a version to come": (
        "STALE", lambda mesh: replace(split_at(mesh, 0.03), base_version=mesh.version + 5)
    ),
    "planned on no version": ("STALE", lambda mesh: replace(split_at(mesh, 0.03), base_version=0)),
    "read what is not there": (
        "STALE", lambda mesh: replace(
            split_at(mesh, 0.03), read_elements=np.array([UNKNOWN], dtype=np.uint32)
        )
    ),
    "a fixed node moved": ("INVALID", lambda mesh: _moved(mesh, 0, [0.001, 0.0, 0.0])),
    "a place that is not finite": ("INVALID", lambda mesh: _moved(mesh, 62, [np.nan, 0.0, 0.0])),
    "an element turned over": ("INVALID", lambda mesh: _moved(mesh, 62, [0.5, 0.5, 0.5])),
    "an element without volume": (
        "INVALID", lambda mesh: _moved(mesh, 62, mesh.rest[63].tolist())
    ),
    "an unknown element": ("INVALID", lambda mesh: _removed(mesh, UNKNOWN)),
    "copies that nobody has": (
        "INVALID", lambda mesh: replace(
            split_at(mesh, 0.03), rewritten_elements=np.empty(0, dtype=np.uint32),
            rewritten_nodes=np.empty((0, 4), dtype=np.uint32),
        )
    ),
    "arrays that do not fit": (
        "INVALID", lambda mesh: replace(
            split_at(mesh, 0.03), copy_parents=np.empty(0, dtype=np.uint32)
        )
    ),
    "a stitch to nothing": ("INVALID", lambda mesh: _sewn(mesh, 3, UNKNOWN)),
    "a stitch from a node to itself": ("INVALID", lambda mesh: _sewn(mesh, 3, 3)),
    "a stitch of a length that is no number": ("INVALID", lambda mesh: _sewn(mesh, 3, 9, np.nan)),
    "an undo that nobody asked for": (
        "INVALID", lambda mesh: replace(_removed(mesh, 3), kind=UNDO)
    ),
}  # fmt: skip
"""Edits asked for with `tissue/apply_edit`; the block of `support.small_block`."""

ALONGSIDE: dict[str, dict[str, str]] = {
    "tissue/cut": {"a cut that would part nothing but fixed or held nodes": "HELD"},
    "tissue/apply_edit": {
        "planned in another epoch": "STALE",
        "the second of two that part the same tissue": "STALE",
        "while an organ is loaded or reset": "BUSY",
    },
    "tissue/undo": {
        "no edit was made": "NOTHING_THERE", "all are undone": "NOTHING_THERE",
        "while an organ is loaded or reset": "BUSY", "while a model is built": "BUSY",
        "the model will not have it": "REFUSED",
    },
    "tissue/redo": {
        "no edit was undone": "NOTHING_THERE", "another edit was made since": "NOTHING_THERE",
        "while an organ is loaded or reset": "BUSY", "while a model is built": "BUSY",
        "the model will not have it": "REFUSED",
    },
    "tissue/closure": {"a hole whose edge is no more": "HOLE_LOST"},
    "tissue/cut, tissue/suture, tissue/add_patch, tissue/closure": {
        "nothing known of the tissue": "NO_TISSUE",
    },
    "tissue/cut, tissue/suture, tissue/add_patch": {
        "the tissue changes under three plans, or the simulation stays busy": "STALE",
        "the simulation does not answer, or begins a new epoch": "SIMULATION_LOST",
        "the simulation or its model will not have the edit": "REFUSED",
    },
}  # fmt: skip
"""What is refused because of what else goes on."""


def as_markdown() -> str:
    """All of it as one table."""
    rows: list[tuple[str, str, str]] = []
    for service, (_, table) in SERVICES.items():
        rows += [(service, code, what) for what, (code, _) in table.items()]
    rows += [("tissue/suture", code, what) for what, (code, _) in WITH_PATCHES.items()]
    rows += [("tissue/apply_edit", code, what) for what, (code, _) in EDITS.items()]
    rows += [(s, code, what) for s, table in ALONGSIDE.items() for what, code in table.items()]
    grouped: dict[tuple[str, str], list[str]] = {}
    for service, code, what in rows:
        grouped.setdefault((service, code), []).append(what)
    lines = ["| request | is refused with | if it is, or names |", "|---|---|---|"]
    for (service, code), whats in grouped.items():
        name = ", ".join(f"`{part}`" for part in service.split(", "))
        lines.append(f"| {name} | `{code}` | {'; '.join(whats)} |")
    return "\n".join(lines)
