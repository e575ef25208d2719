"""Sweeps over nodes and their forces, with torsion springs and stitches where there are some.

Sewn nodes are left out of the sweeps over other nodes; `sweep_sewn_nodes` is theirs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.kernels import springs as plain
from tissue_sim.kernels import torsion as folded
from tissue_sim.kernels.stitches import sweep_sewn

Nodes = NDArray[np.uint32]

IN_SHEETS = 0.5
"""Share of their step that nodes take with momentum in sheets, and in organs with patches.

Springs of tetrahedra point everywhere alike: a node's curvature is about a third of the sum of its
stiffnesses. Through a sheet or a patch and across it all of them may resist along one line, and
with momentum steps beyond 1 do not settle there.
"""


def sweep(
    springs: SpringNetwork,
    nodes: Nodes,
    begin: int,
    end: int,
    state: State,
    step: np.floating,
    force_step: float = 0.0,
) -> float:
    """One Gauss-Seidel sweep over nodes[begin:end]; see `kernels.springs.sweep_nodes`.

    Modifies the state in place. Torsion springs know no `force_step`.

    Returns:
        Largest squared distance a node moved [m^2].
    """
    if springs.torsion is not None:
        none = springs.dtype(0.0)
        return sweep_with_momentum(
            springs, nodes, begin, end, state, step, none, springs.torsion.last_move
        )
    with springs.stitches.set_aside(state):
        return float(
            plain.sweep_nodes(
                nodes, begin, end, springs.arrays, state.prescribed, step,
                springs.dtype(force_step), springs.tiny, state.displacement,
            )
        )  # fmt: skip


def sweep_with_momentum(
    springs: SpringNetwork,
    nodes: Nodes,
    begin: int,
    end: int,
    state: State,
    step: np.floating,
    momentum: np.floating,
    last_move: NDArray[np.floating],
) -> float:
    """One sweep before which every node repeats a share of its last move.

    See `kernels.springs.sweep_nodes_with_momentum`. Modifies the state and `last_move` in place.

    Returns:
        Largest squared distance a node moved [m^2].
    """
    thin = springs.mesh.sheet_rows is not None or len(springs.mesh.patches) > 0
    if thin and momentum > 0.0:
        step = springs.dtype(IN_SHEETS * step)
    with springs.stitches.set_aside(state):
        if springs.torsion is not None:
            return float(
                folded.sweep_folded_nodes(
                    nodes, begin, end, springs.arrays, springs.torsion.arrays, state.prescribed,
                    step, momentum, springs.tiny, state.displacement, last_move,
                )
            )  # fmt: skip
        return float(
            plain.sweep_nodes_with_momentum(
                nodes, begin, end, springs.arrays, state.prescribed, step, momentum, springs.tiny,
                state.displacement, last_move,
            )
        )  # fmt: skip


def sweep_sewn_nodes(springs: SpringNetwork, moves: NDArray[np.bool_], state: State) -> float:
    """One sweep over the sewn nodes. Modifies the state in place.

    Args:
        springs: The network.
        moves: Which of `springs.stitches.nodes` move, shape (s,).
        state: Displacements.

    Returns:
        Largest squared distance a node moved [m^2].
    """
    stitches, (more, stiffer) = springs.stitches, _of_torsion(springs, state)
    return float(
        sweep_sewn(
            stitches.sewn, stitches.threads, springs.arrays, moves, more, stiffer,
            np.empty_like(more), np.empty_like(stiffer), springs.mesh.rest, springs.tiny,
            state.displacement,
        )
    )  # fmt: skip


def _of_torsion(
    springs: SpringNetwork, state: State
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Forces of torsion springs on the sewn nodes [N], and what they add to stiffness [N/m]."""
    nodes = springs.stitches.nodes
    forces, stiffness = np.zeros((len(nodes), 3)), np.zeros(len(nodes))
    if springs.torsion is not None:
        folded.add_torsion_at(
            nodes, springs.arrays, springs.torsion.arrays, state.displacement, springs.tiny, forces
        )
        stiffness += springs.torsion.node_stiffness(nodes)
    return forces, stiffness


def largest_sewn_force(
    springs: SpringNetwork, which: NDArray[np.bool_], state: State
) -> tuple[float, float]:
    """As `largest_force`, of some of the sewn nodes, their stitches' pull included."""
    stitches = springs.stitches
    F, K = stitches.at_nodes(state.displacement)
    more, stiffer = _of_torsion(springs, state)
    of_springs = np.zeros_like(F)
    plain.node_forces(stitches.nodes, springs.arrays, state.displacement, springs.tiny, of_springs)
    F += of_springs + more
    K += stiffer + springs.node_stiffness(stitches.nodes)
    squared = (F[which] ** 2).sum(axis=1)
    steps = squared / np.maximum(K[which], 1e-300) ** 2
    return float(squared.max(initial=0.0)), float(steps.max(initial=0.0))


def largest_force(
    springs: SpringNetwork, nodes: Nodes, begin: int, end: int, state: State
) -> tuple[float, float]:
    """Largest squared force [N^2] and step to balance [m^2] of free nodes, but for sewn ones."""
    with springs.stitches.set_aside(state):
        if springs.torsion is not None:
            force, step = folded.largest_folded_force(
                nodes, begin, end, springs.arrays, springs.torsion.arrays, state.prescribed,
                state.displacement, springs.tiny,
            )  # fmt: skip
        else:
            force, step = plain.largest_force(
                nodes, begin, end, springs.arrays, state.prescribed, state.displacement,
                springs.tiny,
            )  # fmt: skip
    return float(force), float(step)
