"""Patches are drawn in a colour of their own, and the session's events say what was added."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from tissue_interfaces.msg import Journal

from support.patches import patch_edit
from support.sewn_blocks import two_blocks
from support.sheets import connected
from tissue_sim import edit_messages
from tissue_sim.geometry.edit import PATCH as ADDS_PATCH
from tissue_sim.geometry.mesh import Mesh
from viz_bridge.organ_surface import PATCH, SurfacePart, surface_of
from viz_bridge.session_events import journal_events

PLACE = (0.0, 0.0, 0.05)


def colored_as_patch(part: SurfacePart) -> NDArray[np.int32]:
    """Nodes that have the colour of patches."""
    return part.nodes[(part.colors == PATCH.astype(np.uint8)).all(axis=1)]


def organs() -> list[Mesh]:
    return [two_blocks()[0], connected()]


def test_a_patch_has_a_colour_of_its_own_and_the_organ_keeps_its() -> None:
    for mesh in organs():
        before = surface_of(mesh)
        assert not len(colored_as_patch(before.outside))
        change = mesh.apply(patch_edit(mesh, PLACE))
        after = surface_of(mesh)
        found = np.concatenate([colored_as_patch(p) for p in (after.outside, after.inside)])
        assert np.array_equal(np.unique(found), np.unique(change.born_nodes))
        old = after.outside.nodes < change.born_nodes.min()
        assert np.array_equal(after.outside.colors[old], before.outside.colors)


def test_an_event_says_name_nodes_area_and_who_carries_it() -> None:
    for mesh in organs():
        edit = patch_edit(mesh, PLACE, counts=(5, 4), size=(0.02, 0.01))
        named = replace(edit.added_patches[0], name="pericardium")
        applied = mesh.apply(replace(edit, added_patches=(named,), held_by="forceps")).edit
        stamp = Journal().header.stamp
        entry = Journal(edits=[edit_messages.edit_to_msg(applied, b"\0" * 16, "organ", stamp)])
        (event,) = journal_events(entry, {})
        assert event.kind == ADDS_PATCH
        assert event.text == "pericardium: 40 nodes, 2 cm2, carried by forceps (version 2)"
