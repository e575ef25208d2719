"""Saving an organ as it is, and loading it again."""

from __future__ import annotations

import contextlib
import os
import re
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.patches import Patch, Patches, checked_patches
from tissue_sim.geometry.quality import signed_volumes
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.sheet import Sheet, SheetStiffness, checked_sheet
from tissue_sim.geometry.sutures import Sutures, checked_sutures

FORMAT = 1
SUFFIX = ".npz"
_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,99}\Z")
_ARRAYS: dict[str, tuple[str, int]] = {
    "points": ("f", 2),
    "tetrahedra": ("i", 2),
    "regions": ("i", 1),
    "node_file_ids": ("i", 1),
    "element_file_ids": ("i", 1),
    "fixed": ("b", 1),
    "displacement": ("f", 2),
    "region_labels": ("i", 1),
    "region_names": ("U", 1),
    "fibres": ("f", 2),
}


class SnapshotError(ValueError):
    """A snapshot that cannot be written or read."""


class SnapshotNameError(SnapshotError):
    """A name that is not allowed."""


@dataclass(frozen=True)
class Snapshot:
    """An organ at one moment, without the gaps that edits left.

    Attributes:
        raw: Its mesh at rest.
        fixed: Nodes that never move, shape (node_count,).
        displacement: Displacement from rest [m], float32, shape (node_count, 3).
    """

    raw: RawMesh
    fixed: NDArray[np.bool_]
    displacement: NDArray[np.float32]

    def mesh(self) -> Mesh:
        """A mesh of its own."""
        return Mesh(self.raw, self.fixed)


_OF_PATCH = ("young_modulus", "density", "thickness")
_NO_WALLS = np.empty((0, 3), dtype=np.int32)


def path_of(folder: Path, name: str) -> Path:
    """Where a snapshot lies.

    Raises:
        SnapshotNameError: The name is not allowed; it is never a path.
    """
    if not _NAME.match(name):
        raise SnapshotNameError(
            f"the name {name!r} is not allowed; allowed: letters, digits, . _ and -, not starting "
            "with a dot, at most 100"
        )
    return folder / f"{name}{SUFFIX}"


def take(mesh: Mesh, displacement: NDArray[np.floating]) -> Snapshot:
    """An organ as it is now, its rows compacted: copies of everything.

    Args:
        mesh: The mesh.
        displacement: Displacement from rest [m], shape (node_capacity, 3).
    """
    nodes = np.flatnonzero(mesh.node_alive[: mesh.node_rows])
    elements = np.flatnonzero(mesh.element_alive[: mesh.element_rows])
    labels = mesh.regions[elements]
    if mesh.sheet_rows is not None:
        alive = mesh.element_alive[: mesh.element_rows]
        labels = mesh.regions[np.concatenate(mesh.sheet_rows.order(alive))]
        elements = elements[:0]
    row = np.full(mesh.node_rows, -1, dtype=np.int64)
    row[nodes] = np.arange(len(nodes))
    raw = RawMesh(
        points=mesh.rest[nodes],
        tetrahedra=row[mesh.tets[elements]],
        regions=labels,
        region_names=dict(mesh.region_names),
        fibres=mesh.fibres[elements],
        sheet=_renumbered(mesh.sheet, row),
        sutures=mesh.sutures.renumbered(row),
        patches=mesh.patches,
        node_file_ids=mesh.node_file_ids[nodes],
        element_file_ids=mesh.element_file_ids[elements],
        name=mesh.name,
        source=mesh.source,
    )
    return Snapshot(raw, mesh.fixed[nodes], displacement[nodes].astype(np.float32))


def save(snapshot: Snapshot, folder: Path, name: str) -> Path:
    """Write a snapshot; a file of that name stays as it is until the new one is complete.

    Raises:
        SnapshotNameError: The name is not allowed.
        SnapshotError: It cannot be written.
    """
    path = path_of(folder, name)
    raw = snapshot.raw
    values: dict[str, Any] = {
        "format": np.array(FORMAT),
        "name": np.array(raw.name),
        "source": np.array(raw.source),
        "points": raw.points,
        "tetrahedra": raw.tetrahedra,
        "regions": raw.regions,
        "fibres": raw.fibres,
        "node_file_ids": raw.node_file_ids,
        "element_file_ids": raw.element_file_ids,
        "fixed": snapshot.fixed,
        "displacement": snapshot.displacement,
        "region_labels": np.array(list(raw.region_names), dtype=np.int32),
        "region_names": np.array(list(raw.region_names.values()), dtype=np.str_),
    }
    if raw.sheet is not None:
        values |= _sheet_arrays(raw.sheet)
    values |= _suture_arrays(raw.sutures) | _patch_arrays(raw.patches)
    temporary = ""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=".", suffix=".part", dir=folder)
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **values)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        if temporary:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
        raise SnapshotError(f"{path} could not be written: {error.strerror or error}") from error
    return path


def load(folder: Path, name: str) -> Snapshot:
    """Read a snapshot; nothing in it is executed.

    Raises:
        SnapshotNameError: The name is not allowed.
        SnapshotError: There is no such file, or it is not a sound snapshot.
    """
    path = path_of(folder, name)
    try:
        with np.load(path, allow_pickle=False) as file:
            values = {key: file[key] for key in file.files}
    except FileNotFoundError:
        raise SnapshotError(
            f"there is no {path}; saved: {', '.join(saved(folder)) or 'none'}"
        ) from (None)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise SnapshotError(f"{path} is not a snapshot: {error}") from error
    return _checked(path, values)


def saved(folder: Path) -> list[str]:
    """Names of the snapshots in a folder, sorted."""
    return sorted(path.stem for path in folder.glob(f"[!.]*{SUFFIX}"))


def _sheet_arrays(sheet: Sheet) -> dict[str, NDArray[Any]]:
    return {
        "sheet_triangles": sheet.triangles,
        "sheet_thickness": sheet.thickness,
        "sheet_springs": sheet.springs,
        "sheet_categories": sheet.categories,
        "sheet_volumes": sheet.volumes,
        "sheet_stiffness": np.array(astuple(sheet.stiffness)),
        "sheet_walls": sheet.walls,
    }


def _suture_arrays(sutures: Sutures) -> dict[str, NDArray[Any]]:
    return {
        "suture_ids": sutures.ids,
        "suture_nodes": sutures.nodes,
        "suture_lengths": sutures.lengths,
        "suture_stiffness": sutures.stiffness,
        "suture_groups": sutures.groups,
        "suture_next": np.array(sutures.next_id),
    }


def _patch_arrays(patches: Patches) -> dict[str, NDArray[Any]]:
    numbers = [[getattr(item, name) for name in _OF_PATCH] + [*item.normal] for item in patches]
    return {
        "patch_ids": patches.ids,
        "patch_labels": patches.labels,
        "patch_names": np.array([item.name for item in patches], dtype=np.str_),
        "patch_numbers": np.array(numbers, dtype=np.float64).reshape(-1, len(_OF_PATCH) + 3),
        "patch_next": np.array(patches.next_id),
    }


def _checked_patches(path: Path, values: Mapping[str, NDArray[Any]]) -> Patches:
    if "patch_ids" not in values:
        return Patches()  # Saved before there were any.
    try:
        count = len(values["patch_ids"])
        columns = zip(
            values["patch_numbers"].astype(np.float64).reshape(count, len(_OF_PATCH) + 3).tolist(),
            values["patch_names"].reshape(count).tolist(),
            values["patch_ids"].astype(np.int64).reshape(count).tolist(),
            values["patch_labels"].astype(np.int64).reshape(count).tolist(),
            strict=True,
        )
        items = tuple(
            Patch(E, density, thickness, (x, y, z), str(name), patch_id, label)
            for (E, density, thickness, x, y, z), name, patch_id, label in columns
        )
        patches = Patches(items, int(values["patch_next"].item()))
        return checked_patches(patches, values["region_labels"])
    except (KeyError, TypeError, ValueError) as error:
        raise SnapshotError(f"{path} is damaged: its patches: {error}") from error


def _checked_sutures(path: Path, values: Mapping[str, NDArray[Any]]) -> Sutures:
    if "suture_ids" not in values:
        return Sutures()  # Saved before there were any.
    try:
        count = len(values["suture_ids"])
        sutures = Sutures(
            values["suture_ids"].astype(np.uint32),
            values["suture_nodes"].astype(np.int32).reshape(count, 2),
            values["suture_lengths"].astype(np.float64).reshape(count),
            values["suture_stiffness"].astype(np.float64).reshape(count),
            values["suture_groups"].astype(np.uint32).reshape(count),
            int(values["suture_next"].item()),
        )
        return checked_sutures(sutures, np.ones(len(values["points"]), dtype=np.bool_))
    except (KeyError, TypeError, ValueError) as error:
        raise SnapshotError(f"{path} is damaged: its sutures: {error}") from error


def _renumbered(sheet: Sheet | None, row: NDArray[np.int64]) -> Sheet | None:
    """A sheet whose nodes are in other rows."""
    if sheet is None:
        return None
    names = ("triangles", "springs", "walls")
    return replace(sheet, **{name: row[getattr(sheet, name)].astype(np.int32) for name in names})


def _checked_sheet(path: Path, values: Mapping[str, NDArray[Any]]) -> Sheet | None:
    if "sheet_triangles" not in values:
        return None
    try:
        sheet = Sheet(
            triangles=values["sheet_triangles"].astype(np.int32).reshape(-1, 3),
            thickness=values["sheet_thickness"].astype(np.float64),
            springs=values["sheet_springs"].astype(np.int32).reshape(-1, 2),
            categories=values["sheet_categories"].astype(np.uint8),
            volumes=values["sheet_volumes"].astype(np.float64),
            stiffness=SheetStiffness(*map(float, values["sheet_stiffness"])),
            # Saved before sheets could be cut.
            walls=values.get("sheet_walls", _NO_WALLS).astype(np.int32).reshape(-1, 3),
        )
        return checked_sheet(sheet, values["points"].astype(np.float64))
    except (KeyError, TypeError, ValueError) as error:
        raise SnapshotError(f"{path} is damaged: its surface: {error}") from error


def _checked(path: Path, values: Mapping[str, NDArray[Any]]) -> Snapshot:
    if int(values.get("format", np.array(-1)).sum()) != FORMAT:
        raise SnapshotError(f"{path} is not a snapshot of format {FORMAT}")
    if "fibres" not in values and "tetrahedra" in values:
        # Saved before there were fibres.
        none = np.zeros((len(values["tetrahedra"]), 3), dtype=np.float32)
        values = {**values, "fibres": none}
    for key, (kind, dimensions) in _ARRAYS.items():
        if key not in values or values[key].dtype.kind != kind or values[key].ndim != dimensions:
            raise SnapshotError(f"{path} is damaged: {key} is missing or of another type")
    nodes, elements = len(values["points"]), len(values["tetrahedra"])
    tets = values["tetrahedra"].astype(np.int64)
    shapes = {
        "points": (nodes, 3), "displacement": (nodes, 3), "fixed": (nodes,),
        "node_file_ids": (nodes,), "tetrahedra": (elements, 4), "fibres": (elements, 3),
        "element_file_ids": (elements,),
        "region_names": values["region_labels"].shape,
    }  # fmt: skip
    for key, shape in shapes.items():
        if values[key].shape != shape:
            raise SnapshotError(f"{path} is damaged: {key} has shape {values[key].shape}")
    sheet = _checked_sheet(path, values)
    if (not elements and sheet is None) or (tets < 0).any() or (tets >= nodes).any():
        raise SnapshotError(f"{path} is damaged: its elements name nodes that are not there")
    finite = all(np.isfinite(values[key]).all() for key in ("points", "displacement", "fibres"))
    if not finite or not (signed_volumes(values["points"], tets.astype(np.int32)) > 0).all():
        raise SnapshotError(f"{path} is damaged: it is not finite or an element is inverted")
    items = (
        elements if sheet is None else sum(map(len, (sheet.triangles, sheet.springs, sheet.walls)))
    )
    # Sheets had none before there were patches.
    if len(values["regions"]) not in ((items,) if sheet is None else (0, items)):
        raise SnapshotError(f"{path} is damaged: regions has shape {values['regions'].shape}")
    labels = values["region_labels"].tolist()
    raw = RawMesh(
        points=values["points"].astype(np.float64),
        tetrahedra=tets,
        regions=values["regions"].astype(np.int32),
        fibres=values["fibres"].astype(np.float32),
        sheet=sheet,
        sutures=_checked_sutures(path, values),
        patches=_checked_patches(path, values),
        region_names=dict(zip(labels, map(str, values["region_names"]), strict=True)),
        node_file_ids=values["node_file_ids"].astype(np.int64),
        element_file_ids=values["element_file_ids"].astype(np.int64),
        name=str(values.get("name", "organ")),
        source=str(values.get("source", "")),
    )
    return Snapshot(raw, values["fixed"].astype(np.bool_), values["displacement"].astype("f4"))
