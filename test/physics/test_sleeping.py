"""Tissue at rest that is passed over is where it would be if it were not; LR: see its own test.

Compared with tolerances so small that next to nothing rests, in double precision: in single
precision the last bits alone are larger.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from support.elastic_scenes import ball, block_mesh, build, double, hold, release, steps
from tissue_sim.elastic.chain_mail import ChainMail
from tissue_sim.elastic.quasi_static import QuasiStatic

SIDE = 0.06
MICROMETRE = 1e-6


def shapes_and_visits(name: str, rest_tolerance: float) -> tuple[NDArray[np.float64], int]:
    """Pull one side, then the other, to and fro, then let go; shapes [m], and nodes visited."""
    mesh = block_mesh(7)
    springs, state = double(mesh)
    values = {"levels": 2.0} if name == "quasi_static" else {}
    model, _ = build(name, mesh, springs, state, rest_tolerance=rest_tolerance, **values)
    shapes, visits = [], 0

    def go_on(frames: int) -> None:
        nonlocal visits
        for _ in range(frames):
            steps(model, state, 20)
            shapes.append(state.displacement.copy())
            if isinstance(model, ChainMail):
                visits += len(model.awake)
            elif isinstance(model, QuasiStatic):
                visits += model.active.count

    left = ball(mesh, np.array([0.0, SIDE / 2, SIDE]), 0.012)
    right = ball(mesh, np.array([SIDE, SIDE / 2, SIDE]), 0.012)
    hold(model, state, left, mesh)
    state.displacement[left] = [0.0, 0.002, 0.006]
    go_on(20)
    hold(model, state, right, mesh)
    for way in np.linspace(0.0, 2.0 * np.pi, 20):
        state.displacement[right] = [0.002 * np.sin(way), 0.002, 0.006]
        go_on(1)
    go_on(20)
    release(model, state, mesh)
    go_on(30)
    return np.array(shapes), visits


def test_quasi_static_nodes_that_no_longer_linger_are_where_they_would_be() -> None:
    slept, visited = shapes_and_visits("quasi_static", 1e-8)
    awake, visited_awake = shapes_and_visits("quasi_static", 1e-12)
    assert 0 < visited < 0.9 * visited_awake
    assert np.abs(awake).max() > 0.005
    assert np.abs(slept - awake).max() < MICROMETRE


def test_nodes_that_chain_mail_passes_over_are_where_they_would_be() -> None:
    slept, visited = shapes_and_visits("chain_mail", 1e-8)
    awake, visited_awake = shapes_and_visits("chain_mail", 1e-12)
    assert 0 < visited < 0.9 * visited_awake
    assert np.abs(awake).max() > 0.005
    assert np.abs(slept - awake).max() < MICROMETRE
