"""Rims of patches and edges of holes in a procedure file."""

from __future__ import annotations

import numpy as np
import pytest

from tool_input.located_yaml import ProcedureError
from tool_input.procedure import parse_procedure

TEXT = """\
units: mm
tools:
  carrier: {kind: grab, shape: sphere, size: [2], start: {position: [0, 0, 30]}}
timeline:
  - {at: 0, closure: hole, loop: [[1, 0, 0], [0, 1, 0], [-1, 0, 0]], reach: 2, depth: 4}
  - {at: 1, patch: {name: felt, ellipse: [3, 2], at: [0, 0, 9], carried_by: carrier}}
  - {at: 2, sew_rim: {patch: felt, hole: hole}, spacing: 1.5, running: true, name: rim}
  - at: 3
    sew_rim: {patch: felt, loop: [[1, 0, 0], [0, 1, 0], [-1, 0, 0]]}
    spacing: 2
    length: 0.2
    reach: 5
    stiffness: 300
  - {at: 4, tighten: rim, length: 0.1}
  - {at: 5, closure: hole}
"""


def test_a_hole_is_named_and_a_rim_is_sewn_to_it() -> None:
    named, _, sewn, again, tightened, asked = parse_procedure(TEXT).events
    assert (named.action, named.target) == ("closure", "hole")
    assert named.hole is not None
    assert (named.hole.reach, named.hole.depth) == (0.002, 0.004)
    np.testing.assert_allclose(named.hole.loop[1], [0, 0.001, 0])
    assert sewn.stitching is not None
    assert (sewn.stitching.patch, sewn.stitching.hole) == ("felt", "hole")
    assert (sewn.stitching.spacing, sewn.stitching.running, sewn.value) == (0.0015, True, -1.0)
    assert sewn.stitching.positions.shape == (0, 3)
    assert again.stitching is not None
    assert again.stitching.positions.shape == (3, 3)
    assert (again.stitching.reach, again.stitching.stiffness, again.value) == (0.005, 300.0, 2e-4)
    assert tightened.target == "rim"
    assert asked.hole is not None
    assert len(asked.hole.loop) == 0


def test_what_names_what_another_step_makes_waits_for_its_answer() -> None:
    named, patch, sewn, again, tightened, asked = parse_procedure(TEXT).events
    needs = {
        (later.where, earlier.where)
        for later in (named, patch, sewn, again, tightened, asked)
        for earlier in (named, patch, sewn, again, tightened, asked)
        if later is not earlier and later.time > earlier.time and later.needs(earlier)
    }
    wanted = [(sewn, named), (sewn, patch), (again, patch), (tightened, sewn), (asked, named)]
    assert needs == {(later.where, earlier.where) for later, earlier in wanted}


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        ("patch: felt, hole: hole", "patch: silk, hole: hole", "no patch 'silk' before"),
        ("patch: felt, hole: hole", "patch: felt, hole: vent", "no hole 'vent' before"),
        ("{patch: felt, loop", "{patch: felt, hole: hole, loop", "either hole or loop"),
        (", spacing: 1.5", "", "'spacing' is missing"),
        ("[[1, 0, 0], [0, 1, 0], [-1, 0, 0]], reach", "[[1, 0, 0], [0, 1, 0]], reach", "3 points"),
        ("closure: hole}", "closure: vent}", "no hole was named 'vent'"),
        ("closure: hole}", "closure: hole, depth: 1}", "go with loop"),
    ],
)
def test_mistakes_are_told_with_their_line(was: str, now: str, said: str) -> None:
    assert was in TEXT
    with pytest.raises(ProcedureError, match=said) as caught:
        parse_procedure(TEXT.replace(was, now, 1))
    assert "procedure:" in str(caught.value)
