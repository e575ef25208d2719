"""What hides a place from an eye."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tissue_sim.view import share_in_view

EYE = np.array([0.0, 0.0, 5.0])
CORNERS = np.array([[[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [0.0, 2.0, 1.0]]])


@given(x=st.floats(-3, 3), y=st.floats(-3, 3))
def test_a_triangle_hides_what_lies_in_its_shadow(x: float, y: float) -> None:
    # The shadow on z = 0 is the triangle, five fourths as large.
    a, b, c = 1.25 * CORNERS[0, :, :2]
    sides = [
        (q - p)[0] * (np.array([x, y]) - p)[1] - (q - p)[1] * (np.array([x, y]) - p)[0]
        for p, q in ((a, b), (b, c), (c, a))
    ]
    if min(map(abs, sides)) < 1e-9:
        return
    seen = share_in_view(EYE, np.array([[x, y, 0.0]]), CORNERS)
    assert seen == (0.0 if min(sides) > 0.0 else 1.0)


def test_what_lies_behind_or_near_the_place_or_is_seen_edge_on_hides_nothing() -> None:
    places = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 3.0], [0.0, 0.0, 0.9]])
    assert share_in_view(EYE, places, CORNERS) == 1 / 3
    assert share_in_view(EYE, places, CORNERS, shorter=0.2) == 2 / 3
    assert share_in_view(EYE, places, CORNERS[:, :, [1, 2, 0]] * [1, 0, 1]) == 1.0
    assert share_in_view(EYE, places, np.empty((0, 3, 3))) == 1.0
