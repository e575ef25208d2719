"""Messages of tissue_interfaces to the numeric core's types, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, fields
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Pose, PoseStamped, Wrench, WrenchStamped
from numpy.typing import NDArray
from std_msgs.msg import Header
from tissue_interfaces.msg import CutRequest, Sweep, TissueState, Topology
from tissue_interfaces.msg import Patch as PatchMsg
from tissue_interfaces.msg import Tool as ToolMsg

from tissue_sim.diagnostics import Finding
from tissue_sim.frame import Cut, JournalEntry
from tissue_sim.geometry.incidence import Incidence
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.patches import FIRST_ID as FIRST_PATCH
from tissue_sim.geometry.patches import Patch, Patches
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.sheet import SURFACE, Sheet, SheetStiffness
from tissue_sim.geometry.sheet_rows import NO_ROW, WALL, SheetRows
from tissue_sim.geometry.surface import surface_triangles
from tissue_sim.geometry.sutures import FIRST_ID, Sutures
from tissue_sim.interaction.contact import PARAMETERS as CONTACT
from tissue_sim.interaction.coupling import PARAMETERS as COUPLING
from tissue_sim.interaction.cut_response import PARAMETERS as RESPONSE

ALIVE, FIXED, SPRING = 1, 2, 2
"""Bits of Topology.node_flags and element_flags."""


def header(frame_id: str, stamp: Time) -> Header:
    """A header."""
    return Header(stamp=stamp, frame_id=frame_id)


def stamp_of(nanoseconds: int) -> Time:
    """A time message."""
    seconds, rest = divmod(int(nanoseconds), 1_000_000_000)
    return Time(sec=seconds, nanosec=rest)


def nanoseconds_of(stamp: Time) -> int:
    """A time message in nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def array_of(field: Any, dtype: type[np.generic]) -> NDArray[Any]:
    """A numeric array field; shares memory with messages of rclpy, copies those of bag readers."""
    return np.asarray(field, dtype=dtype)


def fill(field: Any, values: NDArray[Any]) -> None:
    """Append values to an empty array field of a new message; much faster than assigning.

    Args:
        field: An `array.array` as rclpy makes it.
        values: Values, any shape.
    """
    dtype = np.dtype(field.typecode)
    flat = np.ascontiguousarray(values, dtype=dtype).reshape(-1)
    if flat.size:
        field.frombytes(flat.data.cast("B"))


def epoch_field(epoch: bytes) -> NDArray[np.uint8]:
    """An epoch as a field."""
    return np.frombuffer(epoch, dtype=np.uint8)


def epoch_of(message: Any) -> bytes:
    """The epoch of any message that has one."""
    return bytes(bytearray(int(value) for value in message.epoch))


# Poses and tools


def pose_array(pose: Pose) -> NDArray[np.float64]:
    """A pose message as x y z [m] and quaternion x y z w, shape (7,)."""
    p, q = pose.position, pose.orientation
    return np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w], dtype=np.float64)


def fill_pose(message: Pose, pose: Sequence[float] | NDArray[np.float64]) -> None:
    """Write a pose, shape (7,), into a message."""
    x, y, z, qx, qy, qz, qw = (float(value) for value in pose)
    p, q = message.position, message.orientation
    p.x, p.y, p.z = x, y, z
    q.x, q.y, q.z, q.w = qx, qy, qz, qw


def pose_message(pose: Sequence[float] | NDArray[np.float64]) -> Pose:
    """A pose, shape (7,), as a message."""
    message = Pose()
    fill_pose(message, pose)
    return message


def pose_stamped(
    pose: Sequence[float] | NDArray[np.float64], frame_id: str, stamp: Time
) -> PoseStamped:
    """A pose, shape (7,), as a stamped message."""
    return PoseStamped(header=header(frame_id, stamp), pose=pose_message(pose))


def wrench_stamped(wrench: NDArray[np.float64], frame_id: str, stamp: Time) -> WrenchStamped:
    """Force [N] and torque [N m], shape (6,), as a stamped message."""
    return WrenchStamped(header=header(frame_id, stamp), wrench=wrench_message(wrench))


def wrench_message(wrench: NDArray[np.float64]) -> Wrench:
    """Force [N] and torque [N m], shape (6,), as a message."""
    message = Wrench()
    fx, fy, fz, tx, ty, tz = (float(value) for value in wrench)
    force, torque = message.force, message.torque
    force.x, force.y, force.z = fx, fy, fz
    torque.x, torque.y, torque.z = tx, ty, tz
    return message


def tool_arguments(tool: ToolMsg) -> dict[str, Any]:
    """What a Tool message asks for, as arguments of a `set_tool` command."""
    arguments: dict[str, Any] = {
        "id": tool.id,
        "kind": tool.kind,
        "shape": tool.shape,
        "size": [float(value) for value in tool.size],
        "owner": tool.owner,
        "pose": pose_array(tool.pose).tolist(),
    }
    if tool.hold:
        arguments["hold"] = tool.hold
        arguments["coupling"] = {item.name: float(getattr(tool, item.name)) for item in COUPLING}
    if tool.cutting:
        arguments["cutting"] = tool.cutting
        arguments["response"] = {item.name: float(getattr(tool, item.name)) for item in RESPONSE}
    if tool.contact_stiffness:
        arguments["contact"] = {item.name: float(getattr(tool, item.name)) for item in CONTACT}
    return arguments


# Topology


def mesh_to_topology(mesh: Mesh, epoch: bytes, frame_id: str, stamp: Time) -> Topology:
    """A keyframe of a mesh. Takes long on large meshes: call it outside the loop, on a copy."""
    message = Topology(header=header(frame_id, stamp), version=mesh.version, organ=mesh.name)
    message.epoch = epoch_field(epoch)
    nodes, elements = mesh.node_rows, mesh.element_rows
    flags = mesh.node_alive[:nodes] * ALIVE + mesh.fixed[:nodes] * FIXED
    fill(message.node_ids, mesh.node_ids[:nodes])
    fill(message.node_file_ids, mesh.node_file_ids[:nodes])
    fill(message.node_parents, mesh.node_parents[:nodes])
    fill(message.node_flags, flags)
    fill(message.rest_positions, mesh.rest[:nodes])
    fill(message.element_ids, mesh.element_ids[:elements])
    fill(message.element_file_ids, mesh.element_file_ids[:elements])
    springs = (mesh.tets[:elements, 2] < 0) & (mesh.sheet_rows is not None)
    fill(message.element_flags, mesh.element_alive[:elements] * ALIVE + springs * SPRING)
    fill(message.element_regions, mesh.regions[:elements])
    # Removed elements keep the rows they had; their nodes may be gone, their ids are still good.
    if mesh.sheet_rows is None:
        fill(message.tetrahedra, mesh.node_ids[mesh.tets[:elements]])
    fill(message.region_labels, np.array(list(mesh.region_names), dtype=np.int32))
    message.region_names = list(mesh.region_names.values())
    _fill_sutures(message, mesh)
    message.patches = [patch_to_msg(patch) for patch in mesh.patches]
    message.next_patch = mesh.patches.next_id
    if mesh.sheet_rows is not None:
        _fill_sheet(message, mesh, mesh.sheet_rows)
    else:
        fill(message.surface_triangles, mesh.node_ids[surface_triangles(mesh)])
    return message


def _fill_sutures(message: Topology, mesh: Mesh) -> None:
    sutures = mesh.sutures
    fill(message.suture_ids, sutures.ids)
    fill(message.suture_nodes, mesh.node_ids[sutures.nodes])
    fill(message.suture_lengths, sutures.lengths)
    fill(message.suture_stiffness, sutures.stiffness)
    fill(message.suture_groups, sutures.groups)
    message.next_suture = sutures.next_id


def _sutures_of(message: Topology) -> Sutures:
    """The sutures of a keyframe; ids of nodes are their rows."""
    # Bags from before there were sutures do not have them.
    if not hasattr(message, "next_suture"):
        return Sutures()
    return Sutures(
        array_of(message.suture_ids, np.uint32).copy(),
        array_of(message.suture_nodes, np.uint32).reshape(-1, 2).astype(np.int32),
        array_of(message.suture_lengths, np.float64).copy(),
        array_of(message.suture_stiffness, np.float64).copy(),
        array_of(message.suture_groups, np.uint32).copy(),
        int(message.next_suture) or FIRST_ID,
    )


def patch_to_msg(patch: Patch) -> PatchMsg:
    """A patch as a message."""
    message = PatchMsg(
        id=patch.id,
        label=patch.label,
        name=patch.name,
        young_modulus=float(patch.young_modulus),
        density=float(patch.density),
        thickness=float(patch.thickness),
    )
    message.normal = np.asarray(patch.normal, dtype=np.float64)
    return message


def patch_from_msg(message: PatchMsg) -> Patch:
    """A patch from a message."""
    x, y, z = (float(value) for value in message.normal)
    return Patch(
        young_modulus=float(message.young_modulus),
        density=float(message.density),
        thickness=float(message.thickness),
        normal=(x, y, z),
        name=str(message.name),
        id=int(message.id),
        label=int(message.label),
    )


def _patches_of(message: Topology) -> Patches:
    """The patches of a keyframe."""
    # Bags from before there were patches do not have them.
    if not hasattr(message, "next_patch"):
        return Patches()
    items = tuple(patch_from_msg(patch) for patch in message.patches)
    return Patches(items, int(message.next_patch) or FIRST_PATCH)


def _fill_sheet(message: Topology, mesh: Mesh, sheet: SheetRows) -> None:
    """Triangles and springs in the order of their rows; flags tell whose row is whose."""
    rows = mesh.element_rows
    items, alive = mesh.tets[:rows], mesh.element_alive[:rows]
    is_spring = items[:, 2] < 0
    triangles, springs = np.flatnonzero(alive & ~is_spring), np.flatnonzero(alive & is_spring)
    fill(message.surface_triangles, mesh.node_ids[items[triangles, :3]])
    fill(message.triangle_thickness, sheet.tissue[triangles])
    fill(message.springs, mesh.node_ids[items[springs, :2]])
    fill(message.spring_categories, sheet.kinds[springs])
    fill(message.spring_volumes, sheet.tissue[springs])
    fill(message.category_stiffness, np.array(astuple(sheet.stiffness)))
    message.category_names = [field.name for field in fields(sheet.stiffness)]


def _sheet_of(message: Topology) -> Sheet | None:
    """The sheet of a keyframe; None where the tissue is made of tetrahedra."""
    # Bags from before there were sheets do not have it.
    thickness = array_of(getattr(message, "triangle_thickness", ()), np.float64)
    if not len(thickness):
        return None
    factors = map(float, message.category_stiffness)
    named = dict(zip(map(str, message.category_names), factors, strict=True))
    triangles = array_of(message.surface_triangles, np.uint32).reshape(-1, 3).astype(np.int32)
    is_wall = thickness == 0.0
    return Sheet(
        triangles=triangles[~is_wall],
        walls=triangles[is_wall],
        thickness=thickness[~is_wall],
        springs=array_of(message.springs, np.uint32).reshape(-1, 2).astype(np.int32),
        categories=array_of(message.spring_categories, np.uint8),
        volumes=array_of(message.spring_volumes, np.float64),
        stiffness=SheetStiffness(**named),
    )


def topology_to_mesh(message: Topology) -> Mesh:
    """The mesh of a keyframe: a replica that follows later edits with `Mesh.apply`.

    Versions of single nodes and elements are not in a keyframe: every applied edit passes the
    replica's staleness check, since the simulation has judged it already.
    """
    flags = array_of(message.node_flags, np.uint8)
    element_flags = array_of(message.element_flags, np.uint8)
    alive = element_flags & ALIVE > 0
    sheet = _sheet_of(message)
    regions = array_of(message.element_regions, np.int32)
    element_file_ids = array_of(message.element_file_ids, np.int64)
    if sheet is not None:
        # What comes from a file are its nodes; elements get their rows below.
        regions, element_file_ids = regions[:0], element_file_ids[:0]
    raw = RawMesh(
        points=array_of(message.rest_positions, np.float64).reshape(-1, 3),
        tetrahedra=array_of(message.tetrahedra, np.uint32).reshape(-1, 4).astype(np.int64),
        regions=regions,
        region_names=dict(
            zip(map(int, message.region_labels), map(str, message.region_names), strict=True)
        ),
        node_file_ids=array_of(message.node_file_ids, np.int64),
        element_file_ids=element_file_ids,
        sheet=sheet,
        sutures=_sutures_of(message),
        patches=_patches_of(message),
        name=message.organ,
    )
    mesh = Mesh(raw, (flags & FIXED) > 0)
    mesh.version = int(message.version)
    mesh.node_alive[: len(flags)] = (flags & ALIVE) > 0
    mesh.node_parents[: len(flags)] = array_of(message.node_parents, np.uint32)
    if mesh.sheet_rows is not None:
        if len(alive):
            _place_rows(mesh, message, alive, element_flags & SPRING > 0)
            labels = array_of(message.element_regions, np.int32)
            mesh.regions[: len(labels)] = labels
        return mesh
    mesh.element_alive[: len(alive)] = alive
    if not alive.all():
        rows = mesh.element_rows
        mesh.incident = Incidence.build(mesh.tets[:rows], alive, mesh.node_capacity)
    return mesh


def _place_rows(
    mesh: Mesh, message: Topology, alive: NDArray[np.bool_], is_spring: NDArray[np.bool_]
) -> None:
    """Put the elements of a sheet into the rows they had. Modifies the mesh in place."""
    triangles, springs = np.flatnonzero(alive & ~is_spring), np.flatnonzero(alive & is_spring)
    items = np.full((len(alive), 4), NO_ROW, dtype=np.int32)
    corners = array_of(message.surface_triangles, np.uint32).reshape(-1, 3)
    thickness = array_of(message.triangle_thickness, np.float64)
    items[triangles, :3] = corners
    items[springs, :2] = array_of(message.springs, np.uint32).reshape(-1, 2)
    kinds, tissue = np.zeros(len(alive), dtype=np.uint8), np.zeros(len(alive))
    kinds[triangles] = np.where(thickness > 0.0, SURFACE, WALL)
    kinds[springs] = array_of(message.spring_categories, np.uint8)
    tissue[triangles] = thickness
    tissue[springs] = array_of(message.spring_volumes, np.float64)
    mesh.place_items(items, alive, kinds, tissue)


# State


def fill_state(message: TissueState, positions: NDArray[np.float32]) -> None:
    """Write positions [m], shape (node_rows, 3), into a new state message."""
    fill(message.positions, positions)


def positions_from_state(message: TissueState) -> NDArray[np.float32]:
    """Positions [m] of a state message, float32, shape (node_rows, 3); shares its memory."""
    return array_of(message.positions, np.float32).reshape(-1, 3)


# Cuts


def cut_request(
    cut: Cut, entry: JournalEntry, request_id: str, frame_id: str, stamp: Time
) -> CutRequest:
    """What cut_service is asked when a cutting tool is used in a frame."""
    message = CutRequest(
        header=header(frame_id, stamp),
        version=entry.version,
        request_id=request_id,
        tool=cut.tool,
        stroke=cut.stroke,
        strip=cut.strip,
        ends=cut.ends,
        sweep=sweep_message(
            cut.vertices, cut.triangles, entry.frame, frame_id, stamp_of(cut.stamp)
        ),
    )
    message.epoch = epoch_field(entry.epoch)
    return message


def sweep_message(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.integer],
    state_frame: int,
    frame_id: str,
    stamp: Time,
) -> Sweep:
    """A sweep as a message.

    Args:
        vertices: Corners [m], shape (n, 3).
        triangles: Corner rows, shape (m, 3).
        state_frame: Frame of tissue/state it was drawn on; 0: the newest.
        frame_id: Frame the vertices are given in.
        stamp: Stamp of the pose that made it.
    """
    message = Sweep(header=header(frame_id, stamp), state_frame=state_frame)
    fill(message.vertices, vertices)
    fill(message.triangles, triangles)
    return message


# Diagnostics


def diagnostics(name: str, findings: Sequence[Finding], stamp: Time) -> DiagnosticArray:
    """What a node of this name found, as /diagnostics carries it."""
    array = DiagnosticArray(header=header("", stamp))
    array.status = [
        DiagnosticStatus(
            level=bytes([finding.level]),
            name=f"{name}: {finding.name}",
            message=finding.message,
            hardware_id=name,
            values=[KeyValue(key=key, value=value) for key, value in finding.values.items()],
        )
        for finding in findings
    ]
    return array
