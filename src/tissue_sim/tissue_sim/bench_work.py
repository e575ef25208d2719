"""What a step of each model must do at least: bytes to move, roots to take, nodes to visit.

The formulas are explained in docs/sweeps.md and on the models' pages.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.chain_mail import ChainMail
from tissue_sim.elastic.finite_element import FiniteElement
from tissue_sim.elastic.integrators import VERLET, evaluations
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


def done_by(model: MeshModel) -> NDArray[np.float64]:
    """What the last step of a model has done that differs from step to step.

    Returns:
        Places of the list that relaxation has looked at; of corotated elements whether it was an
        iteration, and the elements linearised anew; nothing for others.
    """
    relaxation = getattr(model, "relaxation", None)
    if isinstance(relaxation, RelaxationPass):
        return np.array([relaxation.looked], dtype=np.float64)
    if isinstance(model, FiniteElement) and model.corotated is not None:
        return np.array([model.corotated.iterated, model.corotated.tangent.renewed], np.float64)
    return np.empty(0)


def work_of(model: MeshModel, state: State, done: NDArray[np.float64] | None = None) -> Work:
    """What a step of a model must do at least, as the state is now.

    Args:
        model: The model; relaxation is run once.
        state: Its state.
        done: What steps have done on average, as `done_by` says it; as in the last one if None.

    Raises:
        TypeError: Nobody has counted the work of this model.
    """
    springs = model.springs
    done = done_by(model) if done is None else done
    if isinstance(model, QuasiStatic):
        return _node_sweep(springs, model.active.visited())
    if isinstance(model, Relaxation):
        return _relaxation(model.relaxation, state, done[0])
    if isinstance(model, LocalRelaxation):
        sweep = _node_sweep(springs, model.active.visited())
        return _both(sweep, _relaxation(model.relaxation, state, done[0]))
    if isinstance(model, SpringMass):
        step = _time_step(model)
        if model.relaxation is None:
            return step
        return _both(step, _relaxation(model.relaxation, state, done[0]))
    if isinstance(model, FiniteElement):
        if model.corotated is not None:
            return _corotated(model, *done)
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


def _both(sweep: Work, relaxation: Work) -> Work:
    return Work(
        sweep.moved + relaxation.moved,
        sweep.roots + relaxation.roots,
        relaxation.nodes,
        sweep.springs + relaxation.springs,
        sweep.operations + relaxation.operations,
    )


def _relaxation(relaxation: RelaxationPass, state: State, places: float) -> Work:
    outside = relaxation.run(state)
    nodes, order = int(relaxation.springs.mesh.node_alive.sum()), relaxation.order
    springs = int((order.list.length[: order.used] < REMOVED_LENGTH).sum())
    # Places without a spring are as frequent among those looked at as among all.
    looked = round(springs * places / max(order.used, 1))
    return Work(24 * looked + 53 * nodes, outside, nodes, looked)


def _time_step(model: SpringMass) -> Work:
    springs, stages = model.springs, evaluations(int(model.values["integrator"]))
    nodes = int(springs.mesh.node_alive.sum())
    ends = int(springs.arrays.degree.sum())
    hinges = 0 if springs.torsion is None else len(springs.torsion.nodes)
    elements = int(springs.mesh.element_alive.sum()) if model.internal.volume else 0
    # Forces of one evaluation; each further kind of them passes over the nodes again.
    forces = 12 * ends + 40 * nodes + 32 * hinges
    forces += (
        17 * elements + (48 * nodes if elements else 0) + (40 * nodes if model.internal.home else 0)
    )
    integration = 69 * nodes
    if model.values["integrator"] != VERLET:
        integration = (185 + 129 * stages) * nodes
    return Work(
        stages * forces + integration,
        stages * (ends + hinges),
        nodes,
        stages * ends,
        stages * (180 * hinges + 200 * elements),
    )


def _iteration(model: FiniteElement) -> Work:
    nodes = int(model.mesh.node_alive.sum())
    blocks = int(model.springs.arrays.degree.sum())
    return Work(40 * blocks + 565 * nodes + model.coarse_bytes, 0, nodes, blocks)


def _corotated(model: FiniteElement, iterations: float, renewed: float) -> Work:
    """A share of an iteration, and of a renewal of the tangent."""
    mesh = model.mesh
    nodes, elements = int(mesh.node_alive.sum()), int(mesh.element_alive.sum())
    blocks = int(model.springs.arrays.degree.sum())
    iteration = 40 * blocks + 193 * nodes + model.coarse_bytes
    share = renewed / elements
    renewal = 148 * blocks + 128 * nodes + 18 * elements
    return Work(
        round(iterations * iteration + share * renewal),
        round(32 * renewed),
        nodes,
        round(iterations * blocks),
        round(1750 * renewed),
    )


def _responses(model: FiniteElement) -> Work:
    nodes = int(model.mesh.node_alive.sum())
    return Work(12 * nodes * (model.responses.used + 4), 0, nodes, 0)


def _block_sweep(model: VertexBlockDescent) -> Work:
    active = model.active.visited()
    lanes, nodes = int(model.problem.blocks.lanes[active].sum()), max(len(active), 1)
    more = lanes if len(model.problem.blocks.matter) else 0
    moved = 52 * lanes + 32 * more + 73 * nodes
    return Work(moved, more, nodes, lanes, 262 * lanes + 90 * more + 60 * nodes)


def _chain_mail(links: SpringArrays, awake: NDArray[np.uint32]) -> Work:
    ends, nodes = int(links.degree[awake].sum()), max(len(awake), 1)
    return Work(4 * ends + 49 * nodes, 0, nodes, ends, 36 * ends + 7 * nodes)


def _voxel_mail(model: VoxelMail) -> Work:
    sweep = _chain_mail(model.lattice.arrays, model.awake)
    nodes, asleep = int(model.mesh.node_alive.sum()), model.lattice.rows - len(model.awake)
    moved = sweep.moved + 77 * nodes + 12 * asleep
    return Work(moved, 0, sweep.nodes, sweep.springs, sweep.operations + 66 * nodes)
