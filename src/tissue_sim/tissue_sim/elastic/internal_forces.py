"""What pulls at the nodes of a mesh of springs: the springs' law, their home, their volume."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Parameter, State
from tissue_sim.elastic.sliced_springs import SlicedSprings
from tissue_sim.elastic.spring_laws import PARAMETERS as LAW_PARAMETERS
from tissue_sim.elastic.spring_laws import spring_law
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.inverted import add_turning_forces, list_inverted
from tissue_sim.kernels.slices import slice_forces
from tissue_sim.kernels.spring_laws import add_home_forces, largest_free
from tissue_sim.kernels.torsion import add_torsion_forces
from tissue_sim.kernels.volume_forces import Volumes, add_volume_forces, volume_stiffness

RESERVE = 2.0
"""Growth of the squared face areas of an element up to which its volume is kept at full force."""

WITHIN = 64
"""Steps within which every element is looked at once for inversion."""

RAMP = 0.25
"""Share of inversion from which inverted elements have the full pressure."""

KICK = 4.0
"""Times its stiffness that a stitch counts for stability: threads that go slack and taut within a
step kick, and with 2 lips that were pulled together hard kept jumping; with 3 none did."""

PARAMETERS = (
    Parameter(
        "turning_pressure", 0.2, 0.0, 1.0, "",
        "pressure over Young's modulus that turns elements back which are inside out; 0: none",
    ),
    *LAW_PARAMETERS,
    Parameter(
        "volume_stiffness", 0.0, 0.0, 1e12, "Pa",
        "pressure of tetrahedra per relative change of their volume; 0: none",
    ),
    Parameter(
        "home_stiffness", 0.0, 0.0, 1e15, "N/m^4",
        "stiffness of springs to the rest positions per volume of tissue; 0: none; it ends with "
        "the first cut",
    ),
)  # fmt: skip


def was_cut(mesh: Mesh) -> bool:
    """Whether an edit has changed a mesh in this session, or one has split it before it was saved.

    Nodes that edits make have no id in a file.
    """
    made = mesh.node_alive & (mesh.node_file_ids < 0)
    return mesh.version > 1 or bool(made[: mesh.node_rows].any())


class InternalForces:
    """Forces of springs by their law, of tetrahedra against changes of volume and towards home.

    Attributes:
        law: The springs' law.
        volume: Modulus of the tetrahedra [Pa].
        home: Stiffness of the springs to the rest positions [N/m^4].
        torsion: Torsion springs of a sheet; None: there are none.
        linear: Whether springs are linear and there is nothing else.
        inverted: How many elements are known to be inside out.
    """

    def __init__(self, springs: SpringNetwork, values: dict[str, float]) -> None:
        """Prepare the forces that parameters describe.

        Raises:
            ValueError: A law of negative stiffness, or home forces in tissue that has been cut.
        """
        self.springs, self.mesh = springs, springs.mesh
        self.law = spring_law(values)
        self.volume, self.home = values["volume_stiffness"], values["home_stiffness"]
        if self.home and was_cut(self.mesh):
            raise ValueError(
                f"home_stiffness = {self.home:g} N/m^4 is not possible: the tissue has been cut, "
                "and home forces would pull the cut shut; allowed: 0"
            )
        if self.volume and self.mesh.sheet is not None:
            raise ValueError(
                f"volume_stiffness = {self.volume:g} Pa is for tetrahedra, and {self.mesh.name} is "
                "made of triangles; allowed: 0"
            )
        self.torsion = springs.torsion
        self.linear = self.law.linear and not (self.volume or self.home or self.torsion)
        self._law = self.law.for_kernels(springs.dtype)
        numbers = (self.volume, RESERVE, 1.0, 1.0 / 6.0)
        self._volumes = Volumes(*(springs.dtype(number) for number in numbers))
        turning = values["turning_pressure"] * springs.material.young_modulus
        self._turns = turning > 0.0 and self.mesh.sheet_rows is None
        self._turning = springs.dtype(turning / 6.0)
        self.inverted = self._part = 0
        self._sliced = SlicedSprings(springs)
        self._list = np.zeros(self.mesh.element_capacity, dtype=np.int32)
        self._listed = np.zeros(self.mesh.element_capacity, dtype=np.bool_)
        self._home = np.zeros(0, dtype=springs.dtype)
        if self.home:
            self._home = self._home_stiffness().astype(springs.dtype)

    def compile(self, state: State, F: NDArray[np.floating]) -> None:
        """Compile, or load from the cache, every kernel; nothing is changed."""
        springs, mesh, u = self.springs, self.mesh, state.displacement
        arrays, volumes = springs.arrays, springs.elements.volumes
        list_inverted(
            0, 0, mesh.tets, mesh.element_alive, volumes, arrays.rest, u, self._listed, self._list,
            0,
        )  # fmt: skip
        sliced = self._sliced
        slice_forces(
            0, 0, sliced.slices, sliced.places, self._law, self.law.linear, springs.tiny, u, F
        )
        add_turning_forces(
            self._list, 0, mesh.tets, volumes, arrays.rest, self._turning, RAMP, u, F
        )
        largest_free(0, arrays, state.prescribed, F)
        if self.torsion is not None:
            # At rest it adds nothing.
            add_torsion_forces(arrays, self.torsion.arrays, springs.tiny, np.zeros_like(u), F)

    @property
    def plain(self) -> bool:
        """Whether there are linear springs only, for which `kernels.springs` is quicker."""
        return self.linear and not self.inverted and not len(self.springs.stitches)

    def look(self, u: NDArray[np.floating]) -> None:
        """Look for inverted elements in the next part of the mesh; once before every step."""
        if not self._turns:
            return
        mesh = self.mesh
        most = mesh.element_rows // WITHIN + 1
        begin = self._part * most
        self._part = (self._part + 1) % WITHIN
        self.inverted = list_inverted(
            begin, min(begin + most, mesh.element_rows), mesh.tets, mesh.element_alive,
            self.springs.elements.volumes, self.springs.arrays.rest, u, self._listed, self._list,
            self.inverted,
        )  # fmt: skip

    def _home_stiffness(self) -> NDArray[np.float64]:
        """Stiffness of each node's spring to its rest position [N/m], shape (node_capacity,)."""
        masses: NDArray[np.float64] = self.springs.masses
        return self.home / self.springs.material.density * masses

    def evaluate(self, u: NDArray[np.floating], F: NDArray[np.floating]) -> None:
        """Forces on all nodes [N], held ones as well. Writes `F`, shape (node_capacity, 3)."""
        springs, mesh = self.springs, self.mesh
        arrays = springs.arrays
        sliced = self._sliced
        slice_forces(
            mesh.node_rows, sliced.count, sliced.slices, sliced.places, self._law,
            self.law.linear, springs.tiny, u, F,
        )  # fmt: skip
        if self.volume:
            add_volume_forces(
                mesh.element_rows, mesh.tets, mesh.element_alive, arrays.rest, self._volumes, u, F
            )
        if self.torsion is not None:
            add_torsion_forces(arrays, self.torsion.arrays, springs.tiny, u, F)
        if self.inverted:
            add_turning_forces(
                self._list,
                self.inverted,
                mesh.tets,
                springs.elements.volumes,
                arrays.rest,
                self._turning,
                RAMP,
                u,
                F,
            )
        if self.home:
            add_home_forces(mesh.node_rows, self._home, u, F)
        springs.stitches.add_forces(u, F)

    def largest(self, F: NDArray[np.floating], prescribed: NDArray[np.bool_]) -> float:
        """Largest of the forces `F` on a free node [N]."""
        return math.sqrt(largest_free(self.mesh.node_rows, self.springs.arrays, prescribed, F))

    def stiffness(self, nodes: NDArray[np.int32]) -> NDArray[np.float64]:
        """Half a bound of the row sums of the tangent stiffness [N/m], shape (len(nodes),).

        For linear springs it is the sum of their stiffnesses at each node. Twice the largest of it
        over the node's mass bounds the squared angular frequency of every oscillation.
        """
        half = self.springs.node_stiffness(nodes)
        if not self.linear:
            self._add_stiffness(nodes, half)
        return half + KICK * self.springs.stitches.node_stiffness(nodes)

    def _add_stiffness(self, nodes: NDArray[np.int32], half: NDArray[np.float64]) -> None:
        """Add what a law and other forces than springs' resist. Modifies `half` in place."""
        half *= self.law.slopes()[1]
        if self.volume:
            sums = np.zeros(self.mesh.node_capacity)
            volume_stiffness(nodes, self.springs.elements, self.mesh.rest, sums)
            half += 0.5 * self.volume * RESERVE * sums[nodes]
        if self.torsion is not None:
            half += self.torsion.node_stiffness(nodes)
        if self.home:
            half += 0.5 * self._home_stiffness()[nodes]

    def follow(self, change: EditChange) -> str:
        """Follow an edit, after the springs have: a cut ends the home forces.

        Returns:
            What people should know; empty if nothing.
        """
        self._sliced.follow(change.nodes)
        extra = self.mesh.element_capacity - len(self._list)
        if extra > 0:
            self._list = np.concatenate([self._list, np.zeros(extra, dtype=np.int32)])
            self._listed = np.concatenate([self._listed, np.zeros(extra, dtype=np.bool_)])
        if not self.home or not len(change.elements):
            return ""
        self.home = 0.0
        patched = len(change.born_nodes) > 0
        harm = "hold the patch where it was made" if patched else "pull the cut shut"
        return f"home forces are switched off: they would {harm} (version {change.edit.version})"
