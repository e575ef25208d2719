"""Sweeps over sheets of tissue, and what has to hold of a sheet that was cut."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cut_service.sweep import Sweep
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.components import connected_components
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import CONNECTING, edge_keys, sides, triangle_areas


def square(
    centre: NDArray[np.float64], first: NDArray[np.float64], second: NDArray[np.float64]
) -> Sweep:
    """A parallelogram about a centre, half of its sides given."""
    corners = [centre - first - second, centre + first - second, centre + first + second]
    return Sweep.from_arrays(np.array([*corners, centre - first + second]), [[0, 1, 2], [0, 2, 3]])


def plane_x(x: float, half: float = 0.1) -> Sweep:
    """The plane at x, as large as the organ."""
    return square(np.array([x, 0.0, 0.0]), half * np.eye(3)[1], half * np.eye(3)[2])


def any_square(seed: int, mesh: Mesh) -> Sweep:
    """A square somewhere on the surface."""
    random = np.random.default_rng(seed)
    points = mesh.rest[: mesh.node_rows]
    size = float(np.ptp(points, axis=0).max())
    first, second = random.normal(size=(2, 3))
    first *= size * random.uniform(0.1, 0.7) / np.linalg.norm(first)
    second -= first * (first @ second) / (first @ first)
    second *= size * random.uniform(0.1, 0.7) / np.linalg.norm(second)
    return square(points[random.integers(len(points))], first, second)


def through(mesh: Mesh) -> float:
    """Volume of tissue of the springs through it [m^3]."""
    assert mesh.sheet is not None
    return float(mesh.sheet.volumes[mesh.sheet.categories == CONNECTING].sum())


def assert_valid(mesh: Mesh) -> None:
    """Every edge in at most two triangles, whole fans, and springs between nodes that are there."""
    sheet = mesh.sheet
    assert sheet is not None
    assert (triangle_areas(mesh.rest, sheet.triangles) > 0.0).all()
    _, count = np.unique(edge_keys(sides(sheet.triangles)), return_counts=True)
    assert count.max() <= 2
    living = np.flatnonzero(mesh.node_alive[: mesh.node_rows])
    np.testing.assert_array_equal(living, np.unique(sheet.triangles))
    assert np.isin(sheet.springs, living).all()
    assert np.isin(sheet.walls, living).all()
    keys = edge_keys(sheet.springs) if len(sheet.springs) else np.empty(0, dtype=np.int64)
    assert len(np.unique(keys)) == len(keys)
    assert (sheet.springs[:, 0] != sheet.springs[:, 1]).all()
    assert not np.isin(keys, edge_keys(sides(sheet.triangles))).any()
    assert (sheet.volumes > 0.0).all()
    _assert_whole_fans(sheet.triangles)


def _assert_whole_fans(triangles: NDArray[np.int32]) -> None:
    """The triangles at each node hang together by edges at it: corners joined across such edges."""
    corner = np.arange(3 * len(triangles)).reshape(-1, 3)
    joined = []
    for side in range(3):
        a, b = side, (side + 1) % 3
        ends = triangles[:, [a, b]]
        order = np.argsort(edge_keys(ends), kind="stable")
        joined.append((ends, corner[:, [a, b]], order))
    keys = np.concatenate([edge_keys(ends) for ends, _, _ in joined])
    at = np.concatenate([corners for _, corners, _ in joined])
    ends = np.concatenate([ends for ends, _, _ in joined])
    order = np.argsort(keys, kind="stable")
    pairs = []
    for one, other in pairwise(order):
        if keys[one] == keys[other]:
            for place in (0, 1):
                match = int(np.flatnonzero(ends[other] == ends[one][place])[0])
                pairs.append((at[one][place], at[other][match]))
    items = np.array(pairs, dtype=np.int32).reshape(-1, 2)
    every = np.concatenate([items, np.repeat(corner.reshape(-1, 1), 2, axis=1).astype(np.int32)])
    alive = np.ones(len(every), dtype=np.bool_)
    fans = connected_components(every, alive, 3 * len(triangles))[0]
    assert fans == len(np.unique(triangles))


def assert_as_built_afresh(network: SpringNetwork) -> None:
    """A network that followed edits is the one that would be built now, bit for bit."""
    mesh = network.mesh
    fresh = SpringNetwork(mesh, network.material, network.dtype)
    mine, other = _springs(network), _springs(fresh)
    assert mine == other
    rows = mesh.node_rows
    np.testing.assert_array_equal(network.masses[:rows], fresh.masses[:rows])
    if network.torsion is None or fresh.torsion is None:
        assert network.torsion is fresh.torsion
        return
    assert _hinges(network) == _hinges(fresh)
    everywhere = np.arange(rows, dtype=np.int32)
    np.testing.assert_allclose(
        network.torsion.node_stiffness(everywhere), fresh.torsion.node_stiffness(everywhere)
    )


def _springs(network: SpringNetwork) -> dict[tuple[int, int], tuple[float, float, int]]:
    springs, rows = network.springs, network.rows
    return {
        (int(a), int(b)): (float(k), float(length), int(category))
        for (a, b), k, length, category, alive in zip(
            springs.ends[:rows], springs.stiffness, springs.length, network.categories,
            springs.alive, strict=False,
        )
        if alive
    }  # fmt: skip


def _hinges(network: SpringNetwork) -> dict[tuple[int, ...], tuple[float, float]]:
    torsion = network.torsion
    assert torsion is not None
    return {
        tuple(map(int, nodes)): (float(k), float(angle))
        for nodes, k, angle in zip(
            torsion.nodes, torsion.stiffness, torsion.arrays.angle, strict=True
        )
        if k > 0.0
    }
