"""Holes that have a name, drawn: their edges as lines, how far they are closed as curves."""

from __future__ import annotations

import rerun as rr

from tissue_sim.geometry.holes import HoleLostError
from tissue_sim.hole_messages import hole_from_msg
from viz_bridge.cdr import Message
from viz_bridge.organ_follower import OrganFollower

EDGE = (30, 30, 30)
EDGE_RADIUS = 0.0003
"""Radius of the line along an edge [m]."""


def log_holes(stream: rr.RecordingStream, organ: OrganFollower, message: Message) -> None:
    """Draw a message of `tissue/holes` at the time that is set.

    Args:
        stream: Where to.
        organ: The organ, whose newest shape the edges are drawn on.
        message: The message.
    """
    shape = organ.replica.shape_at(0)
    for hole in message.holes:
        name = rr.escape_entity_path_part(str(hole.name))
        if not hole.problem:
            covered, gap = 100.0 * float(hole.covered), 1e3 * float(hole.gap)
            stream.log(f"plots/closure/{name}/covered", rr.Scalars(covered))
            stream.log(f"plots/closure/{name}/gap", rr.Scalars(gap))
        if organ.mesh is None or shape is None:
            continue
        try:
            loop = hole_from_msg(hole).loop(organ.mesh, shape.positions)
        except HoleLostError:
            stream.log(f"organ/holes/{name}", rr.Clear(recursive=False))
            continue
        edge = rr.LineStrips3D([[*loop, loop[0]]], radii=[EDGE_RADIUS], colors=[EDGE])
        stream.log(f"organ/holes/{name}", edge)
