"""Sweeps over nodes and their forces, with torsion springs where a network has them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.kernels import springs as plain
from tissue_sim.kernels import torsion as folded

Nodes = NDArray[np.uint32]

IN_SHEETS = 0.5
"""Share of their step that nodes of a sheet take with momentum.

Springs of tetrahedra point everywhere alike: a node's curvature is about a third of the sum of its
stiffnesses. Through a sheet and across it all of them may resist along one line, and with momentum
steps beyond 1 do not settle there.
"""


def sweep(
    springs: SpringNetwork, nodes: Nodes, begin: int, end: int, state: State, step: np.floating
) -> float:
    """One Gauss-Seidel sweep over nodes[begin:end]; see `kernels.springs.sweep_nodes`.

    Modifies the state in place.

    Returns:
        Largest squared distance a node moved [m^2].
    """
    if springs.torsion is not None:
        none = springs.dtype(0.0)
        return sweep_with_momentum(
            springs, nodes, begin, end, state, step, none, springs.torsion.last_move
        )
    return float(
        plain.sweep_nodes(
            nodes, begin, end, springs.arrays, state.prescribed, step, springs.tiny,
            state.displacement,
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
    if springs.mesh.sheet_rows is not None and momentum > 0.0:
        step = springs.dtype(IN_SHEETS * step)
    if springs.torsion is not None:
        return float(
            folded.sweep_folded_nodes(
                nodes, begin, end, springs.arrays, springs.torsion.arrays, state.prescribed, step,
                momentum, springs.tiny, state.displacement, last_move,
            )
        )  # fmt: skip
    return float(
        plain.sweep_nodes_with_momentum(
            nodes, begin, end, springs.arrays, state.prescribed, step, momentum, springs.tiny,
            state.displacement, last_move,
        )
    )  # fmt: skip


def largest_force(
    springs: SpringNetwork, nodes: Nodes, begin: int, end: int, state: State
) -> tuple[float, float]:
    """Largest squared force [N^2] and step to balance [m^2] of free nodes in nodes[begin:end]."""
    if springs.torsion is not None:
        force, step = folded.largest_folded_force(
            nodes, begin, end, springs.arrays, springs.torsion.arrays, state.prescribed,
            state.displacement, springs.tiny,
        )  # fmt: skip
    else:
        force, step = plain.largest_force(
            nodes, begin, end, springs.arrays, state.prescribed, state.displacement, springs.tiny
        )
    return float(force), float(step)
