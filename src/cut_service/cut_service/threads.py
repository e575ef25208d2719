"""Threads that a blade cuts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cut_service.sweep import Sweep
from cut_service.sweep_kernels import crossed_edges
from cut_service.work import Plan, Report
from tissue_sim.geometry.components import parts_of
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh

KIND = "unsuture"
"""Kind of an edit that cuts threads and no tissue."""

NEAR = 0.25e-3
"""Distance [m] between a blade and the middle of a thread shorter than twice this which it cuts:
where lips are closed there is hardly a thread between them to pass through."""


def cut_threads(mesh: Mesh, positions: NDArray[np.floating], sweep: Sweep) -> NDArray[np.uint32]:
    """Ids of the sutures that what is new of a sweep cuts.

    Args:
        mesh: The mesh.
        positions: Current node positions [m], shape (node_rows, 3).
        sweep: What a blade passes.
    """
    table = mesh.sutures
    if not len(table):
        return table.ids
    places = np.ascontiguousarray(positions, dtype=np.float64)
    new = replace(sweep, triangles=sweep.triangles[sweep.old :], old=0, beyond=None)
    # An element whose edges but one have no length, to the loop that finds crossed edges.
    items = np.ascontiguousarray(table.nodes[:, [0, 1, 1, 1]], dtype=np.int32)
    masks = np.zeros(len(table), dtype=np.uint8)
    rows = np.arange(len(table), dtype=np.int32)
    crossed_edges(places, items, rows, new.vertices, new.triangles, masks)
    ends = places[table.nodes]
    short = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) < 2.0 * NEAR
    near = new.distance(ends.mean(axis=1)) <= NEAR
    return table.ids[(masks > 0) | (short & near)]


def with_threads_cut(mesh: Mesh, made: Plan, threads: NDArray[np.uint32]) -> Plan:
    """A plan that cuts threads as well.

    If somebody else changes one of them meanwhile it is stale, as its nodes are read.
    """
    if not len(threads):
        return made
    table, edit = mesh.sutures, made.edit
    ends = mesh.node_ids[table.nodes[table.places_of(threads)].ravel()]
    read = np.union1d(edit.read_nodes, ends).astype(np.uint32)
    said = f"{len(threads)} stitches cut"
    notes = f"{made.report.notes}; {said}" if made.report.notes else said
    return replace(
        made,
        edit=replace(edit, removed_sutures=threads, read_nodes=read),
        report=replace(made.report, notes=notes),
    )


def no_tissue_cut(mesh: Mesh) -> Plan:
    """A plan that cuts no tissue."""
    report = Report(0, 0, 0, parts_of(mesh), (0.0, 0.0), (0.0, 0.0), 0.0, 0)
    return Plan(TopologyEdit(mesh.version, kind=KIND), report, np.empty((0, 3, 3)))
