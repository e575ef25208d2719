"""Loops over the block rows of a stiffness matrix, and those of conjugate gradients.

Symbols: K_ij the 3x3 block of nodes i and j [N/m], x displacement-like [m], V volume [m^3], g_a the
gradient of the shape function of an element's node a [1/m], lambda and mu Lame's constants [Pa], k
the stiffness of its fibres [Pa] and f the unit vector along them.

A row is never stored with its diagonal: the blocks of a row sum to zero, so that

    (K x)_i = sum_j K_ij (x_j - x_i),

which is exactly zero for a translation and precise in single precision for small differences.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.matter import Matter
from tissue_sim.kernels.networks import Elements
from tissue_sim.kernels.springs import FAST


class BlockRows(NamedTuple):
    """Off-diagonal 3x3 blocks by node, in the places of the spring network's lists.

    Attributes:
        start: Where a node's row begins, shape (node_capacity,), uint32.
        degree: Blocks in the row, shape (node_capacity,), uint32.
        neighbour: Column of each block, uint32.
        blocks: The blocks [N/m], shape (places, 9), row by row.
    """

    start: NDArray[np.uint32]
    degree: NDArray[np.uint32]
    neighbour: NDArray[np.uint32]
    blocks: NDArray[np.floating]


class Vectors(NamedTuple):
    """Vectors of conjugate gradients, shape (node_capacity, 3) each.

    Attributes:
        x: The solution.
        r: The residual.
        z: The preconditioned residual.
        p: The direction.
        q: K p.
    """

    x: NDArray[np.floating]
    r: NDArray[np.floating]
    z: NDArray[np.floating]
    p: NDArray[np.floating]
    q: NDArray[np.floating]


class Aggregates(NamedTuple):
    """Parts that move as rigid bodies.

    Attributes:
        label: Aggregate of each node; -1: none, shape (node_capacity,).
        arms: Node minus its aggregate's centre, in lengths of an aggregate, shape
            (node_capacity, 3).
    """

    label: NDArray[np.int32]
    arms: NDArray[np.floating]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def shape_gradients(
    rest: NDArray[np.float64], tets: NDArray[np.int32], element: int, g: NDArray[np.float64]
) -> float:
    """Gradients g_a of an element's shape functions [1/m]; writes `g`, shape (4, 3).

    Returns:
        The volume [m^3]; 0 for an element without one, whose gradients are not written.
    """
    a, b, c, d = tets[element, 0], tets[element, 1], tets[element, 2], tets[element, 3]
    # Numbers and no array of them: making one takes longer than all the rest.
    x0, x1, x2 = rest[b, 0] - rest[a, 0], rest[b, 1] - rest[a, 1], rest[b, 2] - rest[a, 2]
    y0, y1, y2 = rest[c, 0] - rest[a, 0], rest[c, 1] - rest[a, 1], rest[c, 2] - rest[a, 2]
    z0, z1, z2 = rest[d, 0] - rest[a, 0], rest[d, 1] - rest[a, 1], rest[d, 2] - rest[a, 2]
    g[1, 0], g[1, 1], g[1, 2] = y1 * z2 - y2 * z1, y2 * z0 - y0 * z2, y0 * z1 - y1 * z0
    g[2, 0], g[2, 1], g[2, 2] = z1 * x2 - z2 * x1, z2 * x0 - z0 * x2, z0 * x1 - z1 * x0
    g[3, 0], g[3, 1], g[3, 2] = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    six = x0 * g[1, 0] + x1 * g[1, 1] + x2 * g[1, 2]
    if six == 0.0:
        return 0.0
    for k in range(3):
        g[1, k] /= six
        g[2, k] /= six
        g[3, k] /= six
        g[0, k] = -(g[1, k] + g[2, k] + g[3, k])
    return abs(six) / 6.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def assemble_rows(
    nodes: NDArray[np.int32],
    elements: Elements,
    rest: NDArray[np.float64],
    matter: Matter,
    rows: BlockRows,
    place_of: NDArray[np.int32],
    inverse: NDArray[np.floating],
) -> None:
    """Rows of nodes and the inverses of their diagonal blocks, from the elements at them.

    K_ab = V (lambda g_a g_b^T + mu g_b g_a^T + mu (g_a . g_b) I + k (f . g_a)(f . g_b) f f^T), the
    last term being that of the energy k (f . strain f)^2 / 2.

    Args:
        nodes: Rows to assemble.
        elements: The mesh.
        rest: Rest positions [m], shape (node_capacity, 3).
        matter: What the elements are made of.
        rows: The matrix; the rows of the nodes are written.
        place_of: -1 for each node, and -1 again afterwards, shape (node_capacity,).
        inverse: Inverse diagonal blocks [m/N], shape (node_capacity, 9); written; zero for a node
            without elements.
    """
    g, f = np.empty((4, 3)), matter.fibres
    diagonal = np.empty((3, 3))
    sums = np.empty((1024, 9))
    for node in nodes:
        begin, degree = np.int64(rows.start[node]), np.int64(rows.degree[node])
        if degree > len(sums):
            sums = np.empty((2 * degree, 9))
        sums[:degree] = 0.0
        # Of two places for one neighbour, a spring's and a stitch's behind it, the first counts.
        for place in range(degree - 1, -1, -1):
            place_of[rows.neighbour[begin + place]] = place
        first = np.int64(elements.start[node])
        for entry in range(first, first + np.int64(elements.degree[node])):
            element = elements.data[entry]
            volume = shape_gradients(rest, elements.tets, element, g)
            if volume == 0.0:
                continue
            kind = matter.kind[element]
            lam, mu, k = matter.table[kind, 0], matter.table[kind, 1], matter.table[kind, 2]
            a = 0
            while elements.tets[element, a] != node:
                a += 1
            for b in range(4):
                if b == a:
                    continue
                other = elements.tets[element, b]
                place = int(place_of[other])
                if place < 0:
                    continue  # An element too flat for the network to have its edges.
                dot = g[a, 0] * g[b, 0] + g[a, 1] * g[b, 1] + g[a, 2] * g[b, 2]
                for i in range(3):
                    for j in range(3):
                        entry_ij = lam * g[a, i] * g[b, j] + mu * g[b, i] * g[a, j]
                        sums[place, 3 * i + j] += volume * entry_ij
                    sums[place, 4 * i] += volume * mu * dot
                if k > 0.0:
                    f0, f1, f2 = f[element, 0], f[element, 1], f[element, 2]
                    along = f0 * g[a, 0] + f1 * g[a, 1] + f2 * g[a, 2]
                    along *= volume * k * (f0 * g[b, 0] + f1 * g[b, 1] + f2 * g[b, 2])
                    for i in range(3):
                        for j in range(3):
                            sums[place, 3 * i + j] += along * f[element, i] * f[element, j]
        diagonal[:] = 0.0
        for place in range(degree):
            place_of[rows.neighbour[begin + place]] = -1
            for i in range(3):
                for j in range(3):
                    rows.blocks[begin + place, 3 * i + j] = sums[place, 3 * i + j]
                    diagonal[i, j] -= sums[place, 3 * i + j]
        _invert(diagonal, inverse[node])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _invert(d: NDArray[np.float64], out: NDArray[np.floating]) -> None:
    """Inverse of a symmetric positive definite 3x3 matrix; zero where it is not."""
    c00 = d[1, 1] * d[2, 2] - d[1, 2] * d[2, 1]
    c01 = d[0, 2] * d[2, 1] - d[0, 1] * d[2, 2]
    c02 = d[0, 1] * d[1, 2] - d[0, 2] * d[1, 1]
    determinant = d[0, 0] * c00 + d[1, 0] * c01 + d[2, 0] * c02
    out[:] = 0.0
    if not determinant > 1e-12 * (d[0, 0] + d[1, 1] + d[2, 2]) ** 3 / 27.0:
        return
    out[0], out[1], out[2] = c00 / determinant, c01 / determinant, c02 / determinant
    out[3] = (d[1, 2] * d[2, 0] - d[1, 0] * d[2, 2]) / determinant
    out[4] = (d[0, 0] * d[2, 2] - d[0, 2] * d[2, 0]) / determinant
    out[5] = (d[0, 2] * d[1, 0] - d[0, 0] * d[1, 2]) / determinant
    out[6] = (d[1, 0] * d[2, 1] - d[1, 1] * d[2, 0]) / determinant
    out[7] = (d[0, 1] * d[2, 0] - d[0, 0] * d[2, 1]) / determinant
    out[8] = (d[0, 0] * d[1, 1] - d[0, 1] * d[1, 0]) / determinant


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _row_product(i, rows, x):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """(K x)_i."""
    start, degree, neighbour, blocks = rows
    x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
    y0 = y1 = y2 = x0 - x0
    begin = start[i]
    for place in range(begin, begin + degree[i]):
        j = neighbour[place]
        d0, d1, d2 = x[j, 0] - x0, x[j, 1] - x1, x[j, 2] - x2
        y0 += blocks[place, 0] * d0 + blocks[place, 1] * d1 + blocks[place, 2] * d2
        y1 += blocks[place, 3] * d0 + blocks[place, 4] * d1 + blocks[place, 5] * d2
        y2 += blocks[place, 6] * d0 + blocks[place, 7] * d1 + blocks[place, 8] * d2
    return y0, y1, y2


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def product(
    count: int,
    rows: BlockRows,
    prescribed: NDArray[np.bool_],
    x: NDArray[np.floating],
    y: NDArray[np.floating],
) -> float:
    """Y = K x in free nodes, zero in prescribed ones. Writes `y`, shape (node_capacity, 3).

    Returns:
        x . y.
    """
    dot = 0.0
    for i in range(count):
        if prescribed[i]:
            y[i, 0] = y[i, 1] = y[i, 2] = 0.0
            continue
        y0, y1, y2 = _row_product(i, rows, x)
        y[i, 0], y[i, 1], y[i, 2] = y0, y1, y2
        dot += x[i, 0] * y0 + x[i, 1] * y1 + x[i, 2] * y2
    return dot


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def forces_at(
    nodes: NDArray[np.int32],
    rows: BlockRows,
    u: NDArray[np.floating],
    out: NDArray[np.float64],
) -> None:
    """Internal forces -K u [N] on nodes. Writes `out`, shape (len(nodes), 3)."""
    for place in range(len(nodes)):
        y0, y1, y2 = _row_product(nodes[place], rows, u)
        out[place, 0], out[place, 1], out[place, 2] = -y0, -y1, -y2


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def squared_forces(
    nodes: NDArray[np.int32], rows: BlockRows, u: NDArray[np.floating]
) -> tuple[float, float]:
    """Sum and largest of the squared internal forces on nodes [N^2]."""
    total = largest = 0.0
    for node in nodes:
        y0, y1, y2 = _row_product(node, rows, u)
        squared = np.float64(y0) * y0 + np.float64(y1) * y1 + np.float64(y2) * y2
        total += squared
        largest = max(largest, squared)
    return total, largest


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def advance_solution(
    count: int,
    alpha: float,
    vectors: Vectors,
    inverse: NDArray[np.floating],
    aggregates: Aggregates,
    coarse: NDArray[np.float64],
) -> float:
    """X += alpha p, r -= alpha q, z = D^-1 r, and r summed over the aggregates' rigid motions.

    Args:
        count: Rows of nodes.
        alpha: Length of the step; 0 begins a solution.
        vectors: x, r and z are modified in place.
        inverse: Inverse diagonal blocks, shape (node_capacity, 9).
        aggregates: Parts that move as rigid bodies.
        coarse: Force and moment on each aggregate, shape (aggregates, 6); written.

    Returns:
        r . r.
    """
    x, r, z, p, q = vectors
    aggregate, arms = aggregates
    coarse[:] = 0.0
    norm = 0.0
    a = p.dtype.type(alpha)
    for i in range(count):
        r0, r1, r2 = r[i, 0] - a * q[i, 0], r[i, 1] - a * q[i, 1], r[i, 2] - a * q[i, 2]
        for k in range(3):
            x[i, k] += a * p[i, k]
        r[i, 0], r[i, 1], r[i, 2] = r0, r1, r2
        d = inverse[i]
        z[i, 0] = d[0] * r0 + d[1] * r1 + d[2] * r2
        z[i, 1] = d[3] * r0 + d[4] * r1 + d[5] * r2
        z[i, 2] = d[6] * r0 + d[7] * r1 + d[8] * r2
        norm += r0 * r0 + r1 * r1 + r2 * r2
        g = aggregate[i]
        if g >= 0:
            s0, s1, s2 = arms[i, 0], arms[i, 1], arms[i, 2]
            coarse[g, 0] += r0
            coarse[g, 1] += r1
            coarse[g, 2] += r2
            coarse[g, 3] += s1 * r2 - s2 * r1
            coarse[g, 4] += s2 * r0 - s0 * r2
            coarse[g, 5] += s0 * r1 - s1 * r0
    return norm


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_coarse(
    count: int,
    prescribed: NDArray[np.bool_],
    aggregates: Aggregates,
    coarse: NDArray[np.floating],
    vectors: Vectors,
) -> tuple[float, float]:
    """Add the aggregates' rigid motions to z in free nodes. Modifies z in place.

    Returns:
        r . z, and the largest squared z of a node [m^2].
    """
    r, z = vectors.r, vectors.z
    aggregate, arms = aggregates
    dot = largest = 0.0
    for i in range(count):
        if prescribed[i]:
            z[i, 0] = z[i, 1] = z[i, 2] = 0.0
            continue
        g = aggregate[i]
        if g >= 0:
            s0, s1, s2 = arms[i, 0], arms[i, 1], arms[i, 2]
            c = coarse[g]
            z[i, 0] += c[0] + c[4] * s2 - c[5] * s1
            z[i, 1] += c[1] + c[5] * s0 - c[3] * s2
            z[i, 2] += c[2] + c[3] * s1 - c[4] * s0
        z0, z1, z2 = z[i, 0], z[i, 1], z[i, 2]
        dot += r[i, 0] * z0 + r[i, 1] * z1 + r[i, 2] * z2
        largest = max(largest, np.float64(z0 * z0 + z1 * z1 + z2 * z2))
    return dot, largest


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def next_direction(
    count: int, beta: float, z: NDArray[np.floating], p: NDArray[np.floating]
) -> None:
    """P = z + beta p. Modifies `p` in place."""
    b = p.dtype.type(beta)
    for i in range(count):
        for k in range(3):
            p[i, k] = z[i, k] + b * p[i, k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def aggregate_stiffness(
    count: int,
    rows: BlockRows,
    fixed: NDArray[np.bool_],
    aggregates: Aggregates,
    start: NDArray[np.int32],
    column: NDArray[np.int32],
    out: NDArray[np.float64],
) -> None:
    """Z^T K Z for the rigid motions Z of the aggregates, with the fixed nodes left out.

    Args:
        count: Rows of nodes.
        rows: K.
        fixed: Nodes to leave out.
        aggregates: Parts that move as rigid bodies.
        start: First block of each aggregate, shape (aggregates + 1,).
        column: The other aggregate of each block, ascending within an aggregate; there is one for
            each edge between two aggregates.
        out: The blocks, shape (len(column), 6, 6); added to.
    """
    aggregate, arms = aggregates
    left, right = np.zeros((6, 3)), np.zeros((6, 3))
    half = np.empty((6, 3))
    total = np.empty((3, 3))
    for i in range(count):
        g = aggregate[i]
        if fixed[i] or g < 0:
            continue
        _rigid_motions(arms[i], left)
        total[:] = 0.0
        begin = np.int64(rows.start[i])
        for place in range(begin, begin + np.int64(rows.degree[i])):
            j = rows.neighbour[place]
            for k in range(9):
                total[k // 3, k % 3] -= rows.blocks[place, k]
            h = aggregate[j]
            if fixed[j] or h < 0:
                continue
            _rigid_motions(arms[j], right)
            for a in range(6):
                for c in range(3):
                    half[a, c] = (
                        left[a, 0] * rows.blocks[place, c]
                        + left[a, 1] * rows.blocks[place, 3 + c]
                        + left[a, 2] * rows.blocks[place, 6 + c]
                    )
            _add_block(half, right, out[_block_of(g, h, start, column)])
        for a in range(6):
            for c in range(3):
                half[a, c] = (
                    left[a, 0] * total[0, c] + left[a, 1] * total[1, c] + left[a, 2] * total[2, c]
                )
        _add_block(half, left, out[_block_of(g, g, start, column)])


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _block_of(g, h, start, column):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Place of the block of two aggregates."""
    place = np.int64(start[g])
    while column[place] != h:
        place += 1
    return place


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _add_block(half, right, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    for a in range(6):
        for b in range(6):
            out[a, b] += (
                half[a, 0] * right[b, 0] + half[a, 1] * right[b, 1] + half[a, 2] * right[b, 2]
            )


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _rigid_motions(arm, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Displacement of a node under the six rigid motions of its aggregate; writes `out`."""
    out[0, 0] = out[1, 1] = out[2, 2] = 1.0
    out[3, 1], out[3, 2] = -arm[2], arm[1]
    out[4, 0], out[4, 2] = arm[2], -arm[0]
    out[5, 0], out[5, 1] = -arm[1], arm[0]
