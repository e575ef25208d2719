"""What a step of each model must do at least: bytes to move, roots to take, nodes to visit.

The formulas are explained in docs/sweeps.md and on the models' pages.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.chain_mail import ChainMail
from tissue_sim.elastic.finite_element import FiniteElement
from tissue_sim.elastic.local_relaxation import LocalRelaxation
from tissue_sim.elastic.mesh_model import MeshModel
from tissue_sim.elastic.model import State
from tissue_sim.elastic.quasi_static import QuasiStatic
from tissue_sim.elastic.relaxation import Relaxation, RelaxationPass
from tissue_sim.elastic.spring_mass import SpringMass
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.vertex_block_descent import VertexBlockDescent
from tissue_sim.elastic.voxel_mail import VoxelMail
from tissue_sim.kernels.relaxation import REMOVED_LENGTH
from tissue_sim.kernels.springs import SpringArrays


@dataclass(frozen=True)
class Work:
    """What a step must do at least.

    Attributes:
        moved: Bytes to and from memory with every array touched once.
        roots: Square roots, each with a division.
        nodes: Nodes visited.
        springs: Springs, blocks of a matrix, or elements visited; those of node sweeps as often as
            nodes look at them.
        operations: Additions and multiplications, where they are what takes time.
    """

    moved: int
    roots: int
    nodes: int
    springs: int
    operations: int = 0


def work_of(model: MeshModel, state: State, looked: float | None = None) -> Work:
    """What a step of a model must do at least, as the state is now.

    Args:
        model: The model; relaxation is run once.
        state: Its state.
        looked: Places of the list that a relaxation looks at in a step; as in the run if None.

    Raises:
        TypeError: Nobody has counted the work of this model.
    """
    springs = model.springs
    if isinstance(model, QuasiStatic):
        return _node_sweep(springs, model.active.visited())
    if isinstance(model, Relaxation):
        return _relaxation(model.relaxation, state, looked)
    if isinstance(model, LocalRelaxation):
        sweep = _node_sweep(springs, model.active.visited())
        relaxation = _relaxation(model.relaxation, state, looked)
        return Work(
            sweep.moved + relaxation.moved,
            sweep.roots + relaxation.roots,
            relaxation.nodes,
            sweep.springs + relaxation.springs,
            sweep.operations,
        )
    if isinstance(model, SpringMass):
        return _time_step(springs)
    if isinstance(model, FiniteElement):
        return _responses(model) if model.idle else _iteration(model)
    if isinstance(model, VertexBlockDescent):
        return _block_sweep(model)
    if isinstance(model, ChainMail):
        return _chain_mail(springs.arrays, model.awake)
    if isinstance(model, VoxelMail):
        return _voxel_mail(model)
    raise TypeError(f"nobody has counted the work of {type(model).__name__}")


def _node_sweep(springs: SpringNetwork, nodes: NDArray[np.uint32]) -> Work:
    ends = int(springs.arrays.degree[nodes].sum())
    plain = Work(12 * ends + 49 * len(nodes), ends, len(nodes), ends)
    if springs.torsion is None:
        return plain
    seen = int(springs.torsion.arrays.degree[nodes].sum())
    moved = plain.moved + 12 * seen + 4 * len(nodes)
    return Work(moved, ends + seen, len(nodes), ends, 150 * seen)


def _relaxation(relaxation: RelaxationPass, state: State, places: float | None) -> Work:
    outside = relaxation.run(state)
    nodes, order = int(relaxation.springs.mesh.node_alive.sum()), relaxation.order
    springs = int((order.list.length[: order.used] < REMOVED_LENGTH).sum())
    # Places without a spring are as frequent among those looked at as among all.
    places = relaxation.looked if places is None else places
    looked = round(springs * places / max(order.used, 1))
    return Work(24 * looked + 53 * nodes, outside, nodes, looked)


def _time_step(springs: SpringNetwork) -> Work:
    nodes = int(springs.mesh.node_alive.sum())
    ends = int(springs.arrays.degree.sum())
    hinges = 0 if springs.torsion is None else len(springs.torsion.nodes)
    moved = 12 * ends + 109 * nodes + 32 * hinges
    return Work(moved, ends + hinges, nodes, ends, 180 * hinges)


def _iteration(model: FiniteElement) -> Work:
    nodes = int(model.mesh.node_alive.sum())
    blocks = int(model.springs.arrays.degree.sum())
    return Work(40 * blocks + 565 * nodes + model.coarse_bytes, 0, nodes, blocks)


def _responses(model: FiniteElement) -> Work:
    nodes = int(model.mesh.node_alive.sum())
    return Work(12 * nodes * (model.responses.used + 4), 0, nodes, 0)


def _block_sweep(model: VertexBlockDescent) -> Work:
    active = model.active.visited()
    lanes, nodes = int(model.problem.blocks.lanes[active].sum()), max(len(active), 1)
    return Work(52 * lanes + 73 * nodes, 0, nodes, lanes, 262 * lanes + 60 * nodes)


def _chain_mail(links: SpringArrays, awake: NDArray[np.uint32]) -> Work:
    ends, nodes = int(links.degree[awake].sum()), max(len(awake), 1)
    return Work(4 * ends + 49 * nodes, 0, nodes, ends, 36 * ends + 7 * nodes)


def _voxel_mail(model: VoxelMail) -> Work:
    sweep = _chain_mail(model.lattice.arrays, model.awake)
    nodes, asleep = int(model.mesh.node_alive.sum()), model.lattice.rows - len(model.awake)
    moved = sweep.moved + 77 * nodes + 12 * asleep
    return Work(moved, 0, sweep.nodes, sweep.springs, sweep.operations + 66 * nodes)
