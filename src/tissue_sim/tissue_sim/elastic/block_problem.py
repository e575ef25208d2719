"""The energy that vertex block descent minimises, following the mesh's edits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.material_field import lame_constants
from tissue_sim.elastic.model import State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.kernels.block_forces import block_forces, largest_block_force, total_energy
from tissue_sim.kernels.block_sweeps import Controls, Motion, Problem, repeat_moves, sweep_blocks
from tissue_sim.kernels.mixed_matter import ROWS
from tissue_sim.kernels.neo_hookean import constants
from tissue_sim.kernels.stitches import aim_all
from tissue_sim.kernels.vertex_blocks import VertexBlocks, fill_blocks
from tissue_sim.kernels.vertex_descent import Inertia

CRUSHED = 0.3
"""Share of mu sum V |g|^2 below which a node's stiffness shows crushed elements; at rest, 2.25."""

ANSWER = 2.0
"""Times its mean stiffness at rest with which the far end of a stitch is taken to answer: too much
converges a little later, too little might not."""

THIRD_DERIVATIVE = 1.5
"""Bound of the third derivative of log(1 + p^2)/2 along any line."""


class BlockProblem:
    """Elements by node, material and inertia; what has moved, and what may have to.

    Attributes:
        springs: Which nodes are neighbours.
        blocks: Elements by node.
        awake: Whether a node may have to move, shape (node_capacity,).
        last_move: Last move of each node [m], shape (node_capacity, 3).
        careful: Nodes that needed care in the last sweep.
    """

    def __init__(self, springs: SpringNetwork, step: float, tolerance: float) -> None:
        """Lay out the elements.

        Args:
            springs: Network of the mesh, and what it is made of.
            step: Share of Newton's step.
            tolerance: Largest move in a sweep [m] that counts as rest.
        """
        self.springs, mesh = springs, springs.mesh
        dtype, material = springs.dtype, springs.material
        modulus, ratio = material.young_modulus, material.poisson_ratio
        self._material = constants(modulus, ratio, dtype, springs.tiny)
        self._exact = constants(modulus, ratio, np.float64, springs.tiny)
        mu = 4.0 / 3.0 * float(self._exact.shear)
        self.controls = Controls(
            dtype(step), dtype(tolerance**2),
            dtype((1.0 - step / 2.0) * 6.0 / (THIRD_DERIVATIVE * mu)), dtype(CRUSHED * mu),
            dtype(3e-8),
        )  # fmt: skip
        nodes, rows = mesh.node_capacity, mesh.node_rows
        places = int((mesh.incident.count[:rows].astype(np.int64) + 7).sum()) + 65536
        places += places // 4
        mixed = springs.field.fibrous or not springs.field.one_ratio
        self._base = np.array(lame_constants(material))
        self.blocks = VertexBlocks(
            np.zeros(nodes, dtype=np.uint64), np.zeros(nodes, dtype=np.uint64),
            np.zeros(nodes, dtype=np.uint64), np.zeros(3 * places, dtype=np.uint32),
            np.zeros(10 * places, dtype=dtype), np.zeros(nodes, dtype=dtype),
            np.zeros(nodes, dtype=dtype), np.zeros(ROWS * places if mixed else 0, dtype=dtype),
        )  # fmt: skip
        self._used = self._most_lanes = 0
        self._inertia = Inertia(np.zeros(nodes, dtype=dtype), np.zeros((nodes, 3), dtype=dtype))
        self._seen = np.zeros((nodes, 3), dtype=dtype)
        self.last_move = np.zeros((nodes, 3), dtype=dtype)
        self.awake = np.ones(nodes, dtype=np.bool_)
        self.careful = 0
        self._fill(np.arange(rows, dtype=np.int32))

    def _fill(self, nodes: NDArray[np.int32]) -> None:
        done, scratch = 0, np.empty(9)
        while done < len(nodes):
            done, self._used = fill_blocks(
                nodes, done, self.springs.elements, self.springs.mesh.rest, self._base,
                self.springs.field.matter, self.blocks, self._used, scratch,
            )  # fmt: skip
            if done < len(nodes):
                self._make_room()
        self._most_lanes = max(self._most_lanes, int(self.blocks.lanes[nodes].max(initial=0)))
        self._problem = Problem(
            self.blocks, self.springs.arrays, self._inertia, self._material, self._exact,
            np.empty(9 * self._most_lanes),
        )  # fmt: skip

    def _make_room(self) -> None:
        places = len(self.blocks.corners) // 3 // 4 + 65536
        self.blocks = self.blocks._replace(
            corners=_longer(self.blocks.corners, 3 * places),
            gradients=_longer(self.blocks.gradients, 10 * places),
            matter=_longer(self.blocks.matter, ROWS * places if len(self.blocks.matter) else 0),
        )

    def follow(self, change: EditChange) -> None:
        """Follow an edit that the network has followed, in time proportional to it."""
        extra = self.springs.mesh.node_capacity - len(self.awake)
        if extra > 0:
            blocks, inertia = self.blocks, self._inertia
            self.blocks = blocks._replace(
                start=_longer(blocks.start, extra), lanes=_longer(blocks.lanes, extra),
                room=_longer(blocks.room, extra), shear=_longer(blocks.shear, extra),
                third=_longer(blocks.third, extra),
            )  # fmt: skip
            self._inertia = Inertia(*(_longer(array, extra) for array in inertia))
            self._seen, self.last_move = _longer(self._seen, extra), _longer(self.last_move, extra)
            self.awake = _longer(self.awake, extra)
        self.last_move[change.copied_nodes] = self.last_move[change.copy_parents]
        self._seen[change.copied_nodes] = self._seen[change.copy_parents]
        # Rows that a redo fills again remember what was there before.
        self.last_move[change.born_nodes] = self._seen[change.born_nodes] = 0.0
        self.awake[change.nodes] = True
        self._fill(change.nodes)

    def set_masses(self, nodes: NDArray[np.int32], time_step: float) -> None:
        """Give nodes the inertia of their mass in implicit time steps [s]."""
        self._inertia.factor[nodes] = self.springs.masses[nodes] / time_step**2

    def wake(self, state: State) -> None:
        """Any node may have to move now."""
        self.awake[:] = True
        self._seen[:] = state.displacement

    @property
    def problem(self) -> Problem:
        """What kernels read; edits replace it."""
        return self._problem

    def motion(self, state: State) -> Motion:
        """What kernels change."""
        return Motion(state.displacement, state.prescribed, self.last_move, self._seen, self.awake)

    def sweep(
        self,
        state: State,
        nodes: NDArray[np.uint32],
        begin: int,
        end: int,
        momentum: np.floating,
        unfolding: bool = False,
    ) -> tuple[float, float]:
        """One sweep over nodes[begin:end]. Modifies the state in place.

        Args:
            state: Displacements and prescribed nodes.
            nodes: Rows in the order of the sweep.
            begin: First place.
            end: One past the last.
            momentum: Share of its last move that every node repeats first.
            unfolding: Whether nodes of crushed and inverted elements follow their neighbours.

        Returns:
            Largest squared distance a node moved [m^2]; sum of the new moves plus half of the
            repeated ones, times the latter [m^2].
        """
        motion = self.motion(state)
        with self.springs.stitches.set_aside(state):
            repeat_moves(nodes, begin, end, momentum, self.springs.tiny, motion)
            moved, along, self.careful = sweep_blocks(
                nodes, begin, end, self._problem, self.controls, unfolding, motion
            )
        return float(moved), float(along)

    def sweep_sewn(self, state: State, moves: NDArray[np.bool_], unfolding: bool = False) -> float:
        """One sweep over the sewn nodes, which `sweep` leaves out. Modifies the state in place.

        What its stitches do to a node is quadratic in its place (`kernels.stitches.aim`), and so is
        inertia: they are swept as nodes with more inertia.

        Args:
            state: Displacements and prescribed nodes.
            moves: Which of them move, shape (s,).
            unfolding: As in `sweep`.

        Returns:
            Largest squared distance a node moved [m^2].
        """
        stitches, u = self.springs.stitches, state.displacement
        nodes, inertia = stitches.nodes, self._inertia
        order, moving = nodes.astype(np.uint32), nodes[moves]
        own, target = inertia.factor[nodes].astype(np.float64), inertia.target[nodes].copy()
        F = np.zeros((len(nodes), 3))
        block_forces(nodes, self._problem, u, F)
        F += own[:, None] * (target.astype(np.float64) - u[nodes])
        K = ANSWER * float(self._exact.shear) * self.blocks.shear[nodes] + own
        goal = np.empty((len(nodes), 4))
        self.last_move[moving] = 0
        farthest = 0.0
        with stitches.set_aside(state):
            # Only what moves is free; what is set aside tells its neighbours that it has moved.
            state.prescribed[moving] = False
            for begin, end in stitches.parts:
                aim_all(
                    stitches.sewn, stitches.threads, begin, end, F, K, moves,
                    self.springs.mesh.rest, u, goal,
                )  # fmt: skip
                part = nodes[begin:end]
                self.awake[part] = True
                pull, stiff = goal[begin:end, :3], goal[begin:end, 3] + own[begin:end]
                drive = pull + own[begin:end, None] * (target[begin:end] - u[part])
                inertia.factor[part] = stiff
                inertia.target[part] = u[part] + drive / np.maximum(stiff, 1e-300)[:, None]
                moved, _, _ = sweep_blocks(
                    order, begin, end, self._problem, self.controls, unfolding, self.motion(state)
                )
                farthest = max(farthest, float(moved))
            inertia.factor[nodes], inertia.target[nodes] = own, target
        self.last_move[moving] = 0
        return farthest

    def largest(self, state: State, nodes: NDArray[np.uint32], end: int) -> tuple[float, float]:
        """Largest squared force [N^2] and step [m^2] of free nodes, but for sewn ones."""
        with self.springs.stitches.set_aside(state):
            force, step = largest_block_force(
                nodes, 0, end, self._problem, state.prescribed, state.displacement
            )
        return float(force), float(step)

    def largest_sewn(self, state: State, which: NDArray[np.bool_]) -> tuple[float, float]:
        """As `largest`, of some of the sewn nodes, their stitches' pull included."""
        stitches, u = self.springs.stitches, state.displacement
        nodes = stitches.nodes
        F, K = stitches.at_nodes(u)
        of_elements = np.zeros_like(F)
        block_forces(nodes, self._problem, u, of_elements)
        own = self._inertia.factor[nodes].astype(np.float64)
        F += of_elements + own[:, None] * (self._inertia.target[nodes] - u[nodes])
        K += own + float(self._exact.shear) * self.blocks.shear[nodes]
        squared = (F[which] ** 2).sum(axis=1)
        steps = squared / np.maximum(K[which], 1e-300) ** 2
        return float(squared.max(initial=0.0)), float(steps.max(initial=0.0))

    def forces(self, state: State, rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Internal elastic forces on nodes [N], shape (len(rows), 3)."""
        out = np.zeros((len(rows), 3))
        block_forces(np.asarray(rows, dtype=np.int32), self._problem, state.displacement, out)
        return out + self.springs.stitches.forces(state.displacement, rows)

    def energy(self, state: State) -> float:
        """Elastic energy [J], zero at rest, that of stitches included."""
        rows, u = self.springs.mesh.node_rows, state.displacement
        nowhere = np.zeros((len(u), 3))
        return float(total_energy(rows, self._problem, u)) + self.springs.stitches.add_forces(
            u, nowhere
        )


def _longer(array: NDArray, extra: int) -> NDArray:
    return np.concatenate([array, np.zeros((extra, *array.shape[1:]), dtype=array.dtype)])
