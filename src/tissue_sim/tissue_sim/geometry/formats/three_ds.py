"""3D Studio .3ds surfaces: the chunks that hold vertices and faces.

No maintained library reads them; the format is a small tree of chunks (id, length). Vertices are
stored in world coordinates; materials, cameras, lights and key frames are skipped. All objects of
a file become one surface.

References:
    The Autodesk file format 3DS: chunk ids 4D4D main, 3D3D editor, 4000 object, 4100 triangle
    mesh, 4110 vertices, 4120 faces.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.errors import MeshFileError
from tissue_sim.geometry.raw_mesh import RawMesh

_MAIN, _EDITOR, _OBJECT, _MESH, _VERTICES, _FACES = 0x4D4D, 0x3D3D, 0x4000, 0x4100, 0x4110, 0x4120
_PREFIX = 6


def read_3ds(path: Path) -> RawMesh:
    """Read a 3DS file."""
    content = path.read_bytes()
    if len(content) < _PREFIX or struct.unpack_from("<H", content)[0] != _MAIN:
        raise MeshFileError(f"{path}: not a 3DS file: it does not begin with the main chunk 4D4D")
    points: list[NDArray[np.float64]] = [np.empty((0, 3))]
    triangles: list[NDArray[np.int64]] = [np.empty((0, 3), dtype=np.int64)]
    count = 0
    for begin, end in _meshes(path, content):
        vertices, faces = _read_mesh(path, content, begin, end)
        if len(faces) and faces.max() >= len(vertices):
            raise MeshFileError(
                f"{path}, byte {begin}: a face names vertex {faces.max()} of {len(vertices)}"
            )
        points.append(vertices)
        triangles.append(faces + count)
        count += len(vertices)
    return RawMesh(points=np.concatenate(points), triangles=np.concatenate(triangles))


def _chunks(path: Path, content: bytes, begin: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Chunks between two places, as (id, begin of the payload, end)."""
    while begin < end:
        if begin + _PREFIX > end:
            raise MeshFileError(f"{path}, byte {begin}: a chunk is cut off")
        kind, length = struct.unpack_from("<HI", content, begin)
        if length < _PREFIX or begin + length > end:
            raise MeshFileError(
                f"{path}, byte {begin}: chunk {kind:04X} says {length} bytes, "
                f"{end - begin} are left (cut off?)"
            )
        yield kind, begin + _PREFIX, begin + length
        begin += length


def _meshes(path: Path, content: bytes) -> Iterator[tuple[int, int]]:
    """Payloads of the triangle meshes of all objects."""
    for main, begin, end in _chunks(path, content, 0, len(content)):
        if main != _MAIN:
            continue
        for editor, inner, inner_end in _chunks(path, content, begin, end):
            if editor != _EDITOR:
                continue
            for kind, place, stop in _chunks(path, content, inner, inner_end):
                if kind != _OBJECT:
                    continue
                name_end = content.find(b"\0", place, stop)
                if name_end < 0:
                    raise MeshFileError(f"{path}, byte {place}: an object's name does not end")
                for part, first, last in _chunks(path, content, name_end + 1, stop):
                    if part == _MESH:
                        yield first, last


def _read_mesh(
    path: Path, content: bytes, begin: int, end: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    vertices = np.empty((0, 3))
    faces = np.empty((0, 3), dtype=np.int64)
    for kind, place, stop in _chunks(path, content, begin, end):
        if kind == _VERTICES:
            vertices = _records(path, content, place, stop, "<f4", 3).astype(np.float64)
        elif kind == _FACES:
            faces = _records(path, content, place, stop, "<u2", 4)[:, :3].astype(np.int64)
    return vertices, faces


def _records(
    path: Path, content: bytes, begin: int, end: int, kind: str, width: int
) -> NDArray[np.generic]:
    """A counted list of records, shape (count, width)."""
    if begin + 2 > end:
        raise MeshFileError(f"{path}, byte {begin}: a list without its count")
    count = int.from_bytes(content[begin : begin + 2], "little")
    size = count * width * np.dtype(kind).itemsize
    if begin + 2 + size > end:
        raise MeshFileError(
            f"{path}, byte {begin}: {count} records of {width} numbers do not fit in their chunk"
        )
    return np.frombuffer(content, kind, count * width, begin + 2).reshape(count, width)
