"""Loops over corotated linear tetrahedra: forces, energy and the tangent of a deformed shape.

Symbols: H = grad u = sum_b (u_b - u_a) g_b^T, F = I + H = R S with a rotation R (det R = 1) and S
symmetric, g_a the rest gradient of the shape function of an element's node a [1/m], V the rest
volume, e_k = s_k - 1 with s_k the eigenvalues of S, u_k its eigenvectors and v_k = R u_k. The
energy is that of Hooke's law in the strain S - I,

    Psi = mu sum_k e_k^2 + lambda/2 (sum_k e_k)^2,

its stress R (2 mu (S - I) + lambda tr(S - I) I) = T R with T = sum_k t_k v_k v_k^T,
t_k = 2 mu e_k + lambda tr e: what stiffness warping computes with R from the polar decomposition
of F is exactly the derivative of this energy. With turned gradients h_a = R g_a the force on a node
and the block of two nodes are

    f_a = -V T h_a,
    K_ab = V (lambda h_a h_b^T + mu h_b h_a^T + mu (h_a . h_b) I + [h_a]x^T M [h_b]x),

where M = sum_k m_k v_k v_k^T is what turning a stressed element costs, with s_i, s_j the other two,

    m_k = (mu (e_i + e_j) + lambda tr e) / (s_i + s_j),

the twist eigenvalues of Smith and others. Fibres along f of stiffness k add k e_f^2 / 2 to Psi,
with their stretch s_f = |F f| and e_f = s_f - 1, so with y = F f / s_f

    f_a -= V k e_f (f . g_a) y,
    K_ab += V k (f . g_a)(f . g_b) [y y^T + e_f / s_f (I - y y^T)].

Negative m_k and e_f are left out of K, so that it is positive semidefinite. S comes from the
eigenvectors of F^T F - I = H + H^T + H^T H (Jacobi's rotations), in which nothing is subtracted
that is of size 1: tissue at rest, or moved without turning, has no force bit for bit. The last
column of R is the cross product of the others, so that an inverted element has a negative s_3 and
is pushed back along its shortest way.

References:
    M. Mueller, M. Gross, Interactive virtual materials, Graphics Interface 2004.
    O. Etzmuss, M. Keckeisen, W. Strasser, A fast finite element solution for cloth modelling,
    Pacific Graphics 2003, doi 10.1109/PCCGA.2003.1238265.
    G. Irving, J. Teran, R. Fedkiw, Invertible finite elements for robust simulation of large
    deformation, SCA 2004, doi 10.1145/1028523.1028541.
    B. Smith, F. de Goes, T. Kim, Analytic eigensystems for isotropic distortion energies, ACM
    Transactions on Graphics 38(1), 2019, doi 10.1145/3241041.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.matter import Matter
from tissue_sim.kernels.networks import Elements
from tissue_sim.kernels.springs import FAST
from tissue_sim.kernels.stiffness import BlockRows, _invert, shape_gradients

SMALL = 1e-14
"""Off-diagonal strain that counts as none."""

SHORT = 1e-6
"""Smallest stretch of fibres that is divided by."""

NARROW = 0.1
"""Smallest s_i + s_j that a twist eigenvalue is divided by."""


class Solid(NamedTuple):
    """What does not change with the shape.

    Attributes:
        elements: The mesh.
        rest: Rest positions [m], shape (node_capacity, 3).
        matter: What the elements are made of.
        keep: Share of the negative m_k and e_f in the tangent.
    """

    elements: Elements
    rest: NDArray[np.float64]
    matter: Matter
    keep: float


class Response(NamedTuple):
    """What `respond` writes of an element.

    Attributes:
        gradients: h_a [1/m], shape (4, 3).
        stress: T [Pa], shape (3, 3).
        twist: M [Pa], shape (3, 3).
        strain: Scratch, shape (3, 3).
        axes: Scratch, shape (3, 3).
        turned: Scratch, shape (3, 3).
        block: Scratch, shape (3, 3).
        constants: lambda, mu and k [Pa], shape (3,).
        along: R f, shape (3,).
        pull: k e_f y [Pa], shape (3,).
        holding: Fibres' part of the tangent [Pa], shape (3, 3).
    """

    gradients: NDArray[np.float64]
    stress: NDArray[np.float64]
    twist: NDArray[np.float64]
    strain: NDArray[np.float64]
    axes: NDArray[np.float64]
    turned: NDArray[np.float64]
    block: NDArray[np.float64]
    constants: NDArray[np.float64]
    along: NDArray[np.float64]
    pull: NDArray[np.float64]
    holding: NDArray[np.float64]


def response() -> Response:
    """Room for one element's response."""
    shapes = [(4, 3), *6 * [(3, 3)], *3 * [(3,)], (3, 3)]
    return Response(*(np.zeros(shape) for shape in shapes))


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _diagonalise(a: NDArray[np.float64], U: NDArray[np.float64]) -> None:
    """Eigenvalues on the diagonal of `a`, descending; eigenvectors in the rows of `U`, det U = 1.

    Modifies `a` in place and writes `U`.
    """
    for i in range(3):
        for j in range(3):
            U[i, j] = 1.0 if i == j else 0.0
    small = SMALL * (1.0 + abs(a[0, 0]) + abs(a[1, 1]) + abs(a[2, 2]))
    for _ in range(12):
        if abs(a[0, 1]) + abs(a[0, 2]) + abs(a[1, 2]) <= small:
            break
        for r in range(3):
            p, q = (r + 1) % 3, (r + 2) % 3
            apq = a[p, q]
            if apq == 0.0:
                continue
            half = 0.5 * (a[q, q] - a[p, p])
            t = apq / (abs(half) + np.sqrt(half * half + apq * apq))
            if half < 0.0:
                t = -t
            c = 1.0 / np.sqrt(t * t + 1.0)
            s = t * c
            a[p, p] -= t * apq
            a[q, q] += t * apq
            a[p, q] = a[q, p] = 0.0
            arp, arq = a[r, p], a[r, q]
            a[r, p] = a[p, r] = c * arp - s * arq
            a[r, q] = a[q, r] = s * arp + c * arq
            for k in range(3):
                up, uq = U[p, k], U[q, k]
                U[p, k], U[q, k] = c * up - s * uq, s * up + c * uq
    for i, j in ((0, 1), (1, 2), (0, 1)):
        if a[i, i] < a[j, j]:
            a[i, i], a[j, j] = a[j, j], a[i, i]
            for k in range(3):
                U[i, k], U[j, k] = U[j, k], -U[i, k]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _turned(F, U, V):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Rows v_k = R u_k into V; s_1, s_2 and s_3, which is negative in an inverted element."""
    for k in range(3):
        for i in range(3):
            V[k, i] = F[i, 0] * U[k, 0] + F[i, 1] * U[k, 1] + F[i, 2] * U[k, 2]
    s1 = np.sqrt(V[0, 0] ** 2 + V[0, 1] ** 2 + V[0, 2] ** 2)
    s2 = np.sqrt(V[1, 0] ** 2 + V[1, 1] ** 2 + V[1, 2] ** 2)
    third0, third1, third2 = V[2, 0], V[2, 1], V[2, 2]
    if s1 < 1e-12:  # Collapsed to a point: any rotation is right.
        V[:, :] = U
        return 0.0, 0.0, 0.0
    for i in range(3):
        V[0, i] /= s1
    along = V[0, 0] * V[1, 0] + V[0, 1] * V[1, 1] + V[0, 2] * V[1, 2]
    for i in range(3):
        V[1, i] -= along * V[0, i]
    length = np.sqrt(V[1, 0] ** 2 + V[1, 1] ** 2 + V[1, 2] ** 2)
    if length < 1e-9 * s1:
        # Collapsed to a line: any direction across it is right.
        axis = 0
        for k in range(1, 3):
            if abs(V[0, k]) < abs(V[0, axis]):
                axis = k
        for i in range(3):
            V[1, i] = (1.0 if i == axis else 0.0) - V[0, axis] * V[0, i]
        length = np.sqrt(V[1, 0] ** 2 + V[1, 1] ** 2 + V[1, 2] ** 2)
    for i in range(3):
        V[1, i] /= length
    V[2, 0] = V[0, 1] * V[1, 2] - V[0, 2] * V[1, 1]
    V[2, 1] = V[0, 2] * V[1, 0] - V[0, 0] * V[1, 2]
    V[2, 2] = V[0, 0] * V[1, 1] - V[0, 1] * V[1, 0]
    return s1, s2, V[2, 0] * third0 + V[2, 1] * third1 + V[2, 2] * third2


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _twist(ei, ej, trace, lam, mu, keep):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    m = (mu * (ei + ej) + lam * trace) / max(2.0 + ei + ej, NARROW)
    return m if m > 0.0 else keep * m


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _stretch_fibres(f, k, keep, found):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Force and tangent of fibres into `found`; their energy density [Pa]."""
    C, F, pull, holding = found.strain, found.block, found.pull, found.holding
    # |F f|^2 - |f|^2, in which nothing is subtracted that is of size 1.
    q = 0.0
    for i in range(3):
        q += f[i] * (C[i, 0] * f[0] + C[i, 1] * f[1] + C[i, 2] * f[2])
    stretch = max(np.sqrt(max(1.0 + q, 0.0)), SHORT)
    e = q / (1.0 + stretch)
    across = k * e / stretch
    if across < 0.0:
        across *= keep
    for i in range(3):
        pull[i] = (F[i, 0] * f[0] + F[i, 1] * f[1] + F[i, 2] * f[2]) / stretch
    for i in range(3):
        for j in range(3):
            holding[i, j] = (k - across) * pull[i] * pull[j]
        holding[i, i] += across
    for i in range(3):
        pull[i] *= k * e
    return 0.5 * k * e * e


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def respond(
    solid: Solid, u: NDArray[np.floating], element: int, out: Response
) -> tuple[float, float]:
    """Stress, twist stiffness and turned gradients of an element. Writes `out`.

    Returns:
        V [m^3] and the energy [J]; zeros for an element without volume, of which nothing is
        written.
    """
    tets, rest, matter, keep = solid.elements.tets, solid.rest, solid.matter, solid.keep
    g, T, M, C, U, V, F, constants, _, _, _ = out
    i0, i1, i2, i3 = tets[element, 0], tets[element, 1], tets[element, 2], tets[element, 3]
    if i0 < 0:
        return 0.0, 0.0
    volume = shape_gradients(rest, tets, element, g)
    if volume == 0.0:
        return 0.0, 0.0
    kind = matter.kind[element]
    lam, mu, k = matter.table[kind, 0], matter.table[kind, 1], matter.table[kind, 2]
    constants[0], constants[1], constants[2] = lam, mu, k
    for i in range(3):
        base = np.float64(u[i0, i])
        a, b, c = u[i1, i] - base, u[i2, i] - base, u[i3, i] - base
        for j in range(3):
            F[i, j] = a * g[1, j] + b * g[2, j] + c * g[3, j]
    for i in range(3):
        for j in range(i, 3):
            C[i, j] = (F[0, i] * F[0, j] + F[1, i] * F[1, j] + F[2, i] * F[2, j]) + (
                F[i, j] + F[j, i]
            )
            C[j, i] = C[i, j]
    for i in range(3):
        F[i, i] += 1.0
    fibre_energy = _stretch_fibres(matter.fibres[element], k, keep, out) if k > 0.0 else 0.0
    _diagonalise(C, U)
    s1, s2, s3 = _turned(F, U, V)
    e1, e2 = C[0, 0] / (1.0 + s1), C[1, 1] / (1.0 + s2)
    e3 = C[2, 2] / (1.0 + s3) if s3 >= 0.0 else s3 - 1.0
    trace = e1 + e2 + e3
    p = lam * trace
    t1, t2, t3 = 2.0 * mu * e1 + p, 2.0 * mu * e2 + p, 2.0 * mu * e3 + p
    m1, m2 = _twist(e2, e3, trace, lam, mu, keep), _twist(e3, e1, trace, lam, mu, keep)
    m3 = _twist(e1, e2, trace, lam, mu, keep)
    for i in range(3):
        for j in range(i, 3):
            a, b, c = V[0, i] * V[0, j], V[1, i] * V[1, j], V[2, i] * V[2, j]
            T[i, j] = T[j, i] = t1 * a + t2 * b + t3 * c
            M[i, j] = M[j, i] = m1 * a + m2 * b + m3 * c
    for corner in range(4):
        _turn(g[corner], U, V, g[corner])
    if k > 0.0:
        _turn(matter.fibres[element], U, V, out.along)
    energy = fibre_energy + mu * (e1 * e1 + e2 * e2 + e3 * e3) + 0.5 * p * trace
    return volume, volume * energy


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _turn(x, U, V, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """R x into `out`."""
    a = U[0, 0] * x[0] + U[0, 1] * x[1] + U[0, 2] * x[2]
    b = U[1, 0] * x[0] + U[1, 1] * x[1] + U[1, 2] * x[2]
    c = U[2, 0] * x[0] + U[2, 1] * x[1] + U[2, 2] * x[2]
    for i in range(3):
        out[i] = a * V[0, i] + b * V[1, i] + c * V[2, i]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _force(a, volume, found):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    g, T = found.gradients[a], found.stress
    f0 = -volume * (T[0, 0] * g[0] + T[0, 1] * g[1] + T[0, 2] * g[2])
    f1 = -volume * (T[1, 0] * g[0] + T[1, 1] * g[1] + T[1, 2] * g[2])
    f2 = -volume * (T[2, 0] * g[0] + T[2, 1] * g[1] + T[2, 2] * g[2])
    if found.constants[2] > 0.0:
        along, pull = found.along, found.pull
        s = -volume * (along[0] * g[0] + along[1] * g[1] + along[2] * g[2])
        f0, f1, f2 = f0 + s * pull[0], f1 + s * pull[1], f2 + s * pull[2]
    return f0, f1, f2


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _add_block(rows, node, other, block, transposed):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    place = np.int64(rows.start[node])
    end = place + np.int64(rows.degree[node])
    while place < end and rows.neighbour[place] != other:
        place += 1
    if place < end:  # An element may be too flat for the network to have its edges.
        for i in range(3):
            for j in range(3):
                rows.blocks[place, 3 * i + j] += block[j, i] if transposed else block[i, j]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _block(a, b, volume, found, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """K_ab [N/m] into `out`."""
    lam, mu = volume * found.constants[0], volume * found.constants[1]
    M = found.twist
    g0, g1, g2 = found.gradients[a, 0], found.gradients[a, 1], found.gradients[a, 2]
    h0, h1, h2 = found.gradients[b, 0], found.gradients[b, 1], found.gradients[b, 2]
    dot = mu * (g0 * h0 + g1 * h1 + g2 * h2)
    x, y, z = volume * h0, volume * h1, volume * h2
    # Columns w_j = V M (h x e_j) of V M [h]x; [g]x^T w = -(g x w).
    u0, u1, u2 = M[0, 1] * z - M[0, 2] * y, M[1, 1] * z - M[1, 2] * y, M[2, 1] * z - M[2, 2] * y
    v0, v1, v2 = M[0, 2] * x - M[0, 0] * z, M[1, 2] * x - M[1, 0] * z, M[2, 2] * x - M[2, 0] * z
    w0, w1, w2 = M[0, 0] * y - M[0, 1] * x, M[1, 0] * y - M[1, 1] * x, M[2, 0] * y - M[2, 1] * x
    out[0, 0] = (lam + mu) * g0 * h0 + dot - (g1 * u2 - g2 * u1)
    out[0, 1] = lam * g0 * h1 + mu * h0 * g1 - (g1 * v2 - g2 * v1)
    out[0, 2] = lam * g0 * h2 + mu * h0 * g2 - (g1 * w2 - g2 * w1)
    out[1, 0] = lam * g1 * h0 + mu * h1 * g0 - (g2 * u0 - g0 * u2)
    out[1, 1] = (lam + mu) * g1 * h1 + dot - (g2 * v0 - g0 * v2)
    out[1, 2] = lam * g1 * h2 + mu * h1 * g2 - (g2 * w0 - g0 * w2)
    out[2, 0] = lam * g2 * h0 + mu * h2 * g0 - (g0 * u1 - g1 * u0)
    out[2, 1] = lam * g2 * h1 + mu * h2 * g1 - (g0 * v1 - g1 * v0)
    out[2, 2] = (lam + mu) * g2 * h2 + dot - (g0 * w1 - g1 * w0)
    if found.constants[2] > 0.0:
        along, holding = found.along, found.holding
        s = volume * (along[0] * g0 + along[1] * g1 + along[2] * g2)
        s *= along[0] * h0 + along[1] * h1 + along[2] * h2
        for i in range(3):
            for j in range(3):
                out[i, j] += s * holding[i, j]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_elements(
    begin: int,
    end: int,
    alive: NDArray[np.bool_],
    solid: Solid,
    u: NDArray[np.floating],
    found: Response,
    rows: BlockRows,
    f: NDArray[np.float64],
) -> float:
    """Add the forces and the tangent of living elements [begin, end) to `f` and `rows`.

    Returns:
        Their energy [J].
    """
    total = 0.0
    block = np.empty((3, 3))
    for element in range(begin, end):
        if not alive[element]:
            continue
        volume, energy = respond(solid, u, element, found)
        if volume == 0.0:
            continue
        total += energy
        tet = solid.elements.tets[element]
        for a in range(4):
            f0, f1, f2 = _force(a, volume, found)
            f[tet[a], 0] += f0
            f[tet[a], 1] += f1
            f[tet[a], 2] += f2
            for b in range(a + 1, 4):
                _block(a, b, volume, found, block)
                _add_block(rows, tet[a], tet[b], block, False)
                _add_block(rows, tet[b], tet[a], block, True)
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def assemble_nodes(
    nodes: NDArray[np.int32],
    solid: Solid,
    u: NDArray[np.floating],
    found: Response,
    rows: BlockRows,
) -> None:
    """The rows of some nodes anew. Modifies `rows` in place."""
    elements, block = solid.elements, np.empty((3, 3))
    for node in nodes:
        begin = np.int64(rows.start[node])
        rows.blocks[begin : begin + np.int64(rows.degree[node])] = 0.0
        first = np.int64(elements.start[node])
        for entry in range(first, first + np.int64(elements.degree[node])):
            element = elements.data[entry]
            volume, _ = respond(solid, u, element, found)
            if volume == 0.0:
                continue
            tet = elements.tets[element]
            a = 0
            while tet[a] != node:
                a += 1
            for b in range(4):
                if b != a:
                    _block(a, b, volume, found, block)
                    _add_block(rows, node, tet[b], block, False)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def node_forces(
    nodes: NDArray[np.int32],
    solid: Solid,
    u: NDArray[np.floating],
    found: Response,
    place_of: NDArray[np.int32],
    out: NDArray[np.float64],
) -> None:
    """Internal forces on some nodes [N], each of their elements looked at once.

    Args:
        nodes: Rows of nodes.
        solid: The organ.
        u: Displacements [m].
        found: Scratch.
        place_of: -1 for every node, and again afterwards, shape (node_capacity,).
        out: Written, shape (len(nodes), 3).
    """
    elements = solid.elements
    out[:] = 0.0
    for place in range(len(nodes)):
        place_of[nodes[place]] = place
    for place in range(len(nodes)):
        node = nodes[place]
        if place_of[node] != place:
            continue  # Named again later.
        first = np.int64(elements.start[node])
        for entry in range(first, first + np.int64(elements.degree[node])):
            element = elements.data[entry]
            earliest = place
            for a in range(4):
                other = place_of[elements.tets[element, a]]
                if 0 <= other < earliest:
                    earliest = other
            if earliest < place:
                continue
            volume, _ = respond(solid, u, element, found)
            if volume == 0.0:
                continue
            for a in range(4):
                other = place_of[elements.tets[element, a]]
                if other >= 0:
                    f0, f1, f2 = _force(a, volume, found)
                    out[other, 0] += f0
                    out[other, 1] += f1
                    out[other, 2] += f2
    for place in range(len(nodes)):
        for k in range(3):
            out[place, k] = out[place_of[nodes[place]], k]
    for node in nodes:
        place_of[node] = -1


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def clear_rows(begin: int, end: int, rows: BlockRows) -> None:
    """Zero the rows of nodes [begin, end). Modifies `rows` in place."""
    for node in range(begin, end):
        first = np.int64(rows.start[node])
        rows.blocks[first : first + np.int64(rows.degree[node])] = 0.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def invert_diagonals(
    nodes: NDArray[np.int32],
    rows: BlockRows,
    inverse: NDArray[np.floating],
) -> None:
    """Inverse diagonal blocks of nodes [m/N]. Writes `inverse`, shape (node_capacity, 9)."""
    diagonal = np.empty((3, 3))
    for node in nodes:
        diagonal[:] = 0.0
        first = np.int64(rows.start[node])
        for place in range(first, first + np.int64(rows.degree[node])):
            for i in range(3):
                for j in range(3):
                    diagonal[i, j] -= rows.blocks[place, 3 * i + j]
        _invert(diagonal, inverse[node])
