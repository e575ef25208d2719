"""Planning a cut: from a sweep to a `TopologyEdit` and figures about it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cut_service.errors import CutCode, CutError
from cut_service.removal import remove
from cut_service.sheet_cuts import split_sheet
from cut_service.splitting import split
from cut_service.subdivision import subdivide
from cut_service.sweep import Sweep
from cut_service.threads import cut_threads, no_tissue_cut, with_threads_cut
from cut_service.work import Plan, Report, Settings, Work, prepare, still_nodes
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh

__all__ = ["METHODS", "SHEET_METHOD", "Plan", "Report", "Settings", "plan"]

_PLANNERS: dict[str, Callable[[Work], Plan]] = {
    "split": split,
    "subdivide": subdivide,
    "remove": remove,
}

METHODS = tuple(_PLANNERS)
"""Ways of cutting tetrahedra, the default first."""

SHEET_METHOD = "split"
"""The way of cutting tissue that is made of triangles."""


def plan(
    mesh: Mesh,
    positions: NDArray[np.floating],
    sweep: Sweep,
    method: str = METHODS[0],
    *,
    settings: Settings | None = None,
    held: NDArray[np.uint32] | None = None,
    base_frame: int = 0,
    author: str = "",
    request_id: str = "",
) -> Plan:
    """Plan a cut in the configuration given, of threads too. Nothing is changed.

    Args:
        mesh: The mesh, at the version that `positions` belong to.
        positions: Current node positions [m], shape (node_rows, 3).
        sweep: What to cut along, in the same frame as `positions`.
        method: One of `METHODS`.
        settings: How to cut; default: `Settings()`.
        held: Ids of nodes held by tools. Like fixed nodes they are not snapped.
        base_frame: State frame the positions come from.
        author: Client id for the edit.
        request_id: Request id for the edit.

    Raises:
        SweepError: The sweep is enormous beside the organ.
        CutError: Unknown method, one that cannot cut triangles, positions that do not fit or are
            not finite, or a sweep that cuts nothing (no thread either), that would leave nothing,
            or that would part nothing but fixed or held nodes.
    """
    begin = time.perf_counter()
    if method not in _PLANNERS:
        raise CutError(
            CutCode.UNKNOWN_METHOD, f"unknown method {method!r}; known: {', '.join(METHODS)}"
        )
    planner = _PLANNERS[method]
    if mesh.sheet_rows is not None:
        if method != SHEET_METHOD:
            raise CutError(
                CutCode.REFUSED,
                f"{mesh.name} is made of triangles, which {method} cannot cut; "
                f"allowed: {SHEET_METHOD}",
            )
        planner = split_sheet
    if planner is not split:
        # What they leave at the rim is not known: everything is looked at again.
        sweep = replace(sweep, old=0)
    try:
        made = planner(prepare(mesh, positions, sweep, settings or Settings(), held))
        _refuse_still(mesh, made.edit, held)
    except CutError as error:
        if not error.code.nothing_to_cut or not len(cut_threads(mesh, positions, sweep)):
            raise
        made = no_tissue_cut(mesh)
    made = with_threads_cut(mesh, made, cut_threads(mesh, positions, sweep))
    edit = replace(made.edit, base_frame=base_frame, author=author, request_id=request_id)
    report = replace(made.report, plan_ms=1e3 * (time.perf_counter() - begin))
    return replace(made, edit=edit, report=report)


def _refuse_still(mesh: Mesh, edit: TopologyEdit, held: NDArray[np.uint32] | None) -> None:
    """Refuse a cut of fixed or held nodes alone: their copies stay, and nothing would open."""
    if len(edit.copy_parents):
        parted = mesh.node_rows_of(edit.copy_parents)
    else:
        corners = mesh.tets[mesh.element_rows_of(edit.removed_elements)]
        parted = corners[corners >= 0]
    if len(parted) and still_nodes(mesh, held)[parted].all():
        raise CutError(
            CutCode.HELD,
            f"the cut would part nothing but {len(np.unique(parted))} nodes that are fixed or held "
            "by tools, and nothing would open; let go first, or cut beside them",
        )
