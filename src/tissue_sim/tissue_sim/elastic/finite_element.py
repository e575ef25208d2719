"""Linear static finite elements, exact in every frame once a hold's responses are known."""

from __future__ import annotations

import math
from enum import Enum, auto
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.conjugate_gradients import ConjugateGradients
from tissue_sim.elastic.corotated import Corotated
from tissue_sim.elastic.mesh_model import MeshModel
from tissue_sim.elastic.model import Material, Parameter, State
from tissue_sim.elastic.responses import Responses
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.stiffness import Stiffness
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.responses import add_share
from tissue_sim.kernels.stiffness import forces_at, squared_forces


class Work(Enum):
    """What the iterations are for."""

    NONE = auto()
    RESPONSE = auto()
    """A motion of what is held that has not been met before."""
    CORRECTION = auto()
    """The shape that was found at a grab, a release or a cut."""


class FiniteElement(MeshModel):
    """K u = 0 in the free nodes, with the displacements of fixed and held nodes prescribed.

    The solution is linear in the motion of what is held. Every motion that is new (orthogonal to
    those met since the grab) is solved for by conjugate gradients, which go on from frame to frame,
    and its response is kept; every further pose of the same hold is a sum of responses. What is not
    in equilibrium after a grab, a release or a cut is corrected when no motion waits.

    With `corotated` strain is measured in each element's own frame and every pose is solved anew;
    see `Corotated` and docs/corotated.md.

    Limitations: large rotations swell, unless corotated; see docs/finite_element.md.
    """

    name: ClassVar[str] = "finite_element"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter(
            "tolerance", 2e-4, 1e-12, 0.1, "",
            "residual force in free nodes over the force on prescribed nodes that counts as solved",
        ),
        Parameter("rest_tolerance", 1e-8, 1e-14, 1e-3, "m", "motion that counts as none"),
        Parameter(
            "corotated", 0, 0, 1, "", "1: strain is measured in turned elements", integer=True
        ),
        Parameter(
            "foresight", 1, 0, 1, "",
            "1: when nothing else is left to solve, motions are solved for before they occur",
            integer=True,
        ),
    )  # fmt: skip

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        parameters: dict[str, float],
        springs: SpringNetwork | None = None,
    ) -> None:
        super().__init__(mesh, material, parameters, springs)
        self.corotated: Corotated | None = None
        if self.values["corotated"]:
            self.corotated = Corotated(
                self.springs, material, self.values["tolerance"], self.values["rest_tolerance"]
            )
            return
        self.stiffness = Stiffness(self.springs, material)
        self.responses = Responses(mesh.node_capacity, self.springs.dtype)
        self._solver = ConjugateGradients(self.stiffness)
        self._all = np.arange(mesh.node_capacity, dtype=np.int32)
        self._prescribed = np.empty(0, dtype=np.int32)
        self._work = Work.NONE
        self._corrected = self._waits = self._foresees = False

    @property
    def idle(self) -> bool:
        """Whether everything is solved for the present pose."""
        if self.corotated is not None:
            return self.corotated.settled
        known = self._corrected and not self._waits and not self._foresees
        return self._work is Work.NONE and known

    @property
    def coarse_unknowns(self) -> int:
        """Unknowns of the coarse part of the preconditioner."""
        return self._solver.coarse_unknowns

    def step(self, state: State) -> None:
        """One iteration, where there is anything to solve. Modifies the state in place."""
        if self.corotated is not None:
            self.corotated.step(state)
            return
        left = self.responses.follow_motion(state, self.mesh.node_rows)
        self._waits = left > self.values["rest_tolerance"]
        if self._waits and self._work is Work.RESPONSE and self.responses.overtaken:
            self.responses.abandon()
            self._work = Work.NONE
        begun = self._begin(state)
        if self._work is Work.NONE:
            if self.responses.changed:
                self._show(state)
            return
        # To begin takes as long as an iteration.
        if not begun:
            self._solver.iterate(state.prescribed)
        self._show(state)
        if self._solved(state):
            self._finish()

    def _begin(self, state: State) -> bool:
        """Begin what is most urgent, unless something as urgent goes on; whether it has."""
        if self._waits and self._work is not Work.RESPONSE:
            self._begin_response(state)
        elif self._work is Work.NONE and not self._corrected:
            self._work = Work.CORRECTION
            self._solver.x[:] = 0
            self._solver.begin(state.prescribed, self.responses.sum)
        elif self._work is Work.NONE and self._foresees:
            self._foresees = self.responses.propose(self.mesh.rest)
            if self._foresees:
                self._work = Work.RESPONSE
                self.responses.begin(self._solver.x, proposed=True)
                self._solver.begin(state.prescribed, self._solver.x)
        else:
            return False
        return True

    def _begin_response(self, state: State) -> None:
        if self._work is Work.CORRECTION:
            # A motion comes before the correction, whose part so far stays.
            self.responses.correct(self._solver.x)
            self._corrected = False
        if self.responses.full:
            self.responses.restart_at(state)
            self._corrected = False
            return
        self.responses.begin(self._solver.x)
        self._waits = False
        self._foresees = bool(self.values["foresight"])
        self._work = Work.RESPONSE
        self._solver.begin(state.prescribed, self._solver.x)

    def _show(self, state: State) -> None:
        """Write the shape as far as it is known."""
        share = 1.0 if self._work is Work.CORRECTION else 0.0
        if self._work is Work.RESPONSE:
            share = self.responses.share
        add_share(
            self.mesh.node_rows, state.prescribed, self.responses.sum, share,
            self._solver.x, state.displacement,
        )  # fmt: skip

    def _solved(self, state: State) -> bool:
        solver = self._solver
        if solver.stuck:
            return True
        shape = solver.x if self._work is Work.RESPONSE else state.displacement
        if self._work is Work.CORRECTION and solver.largest <= self.values["rest_tolerance"]:
            return True
        squared, _ = squared_forces(self._prescribed, self.stiffness.rows, shape)
        return solver.residual <= self.values["tolerance"] * math.sqrt(squared)

    def _finish(self) -> None:
        if self._work is Work.RESPONSE:
            self.responses.finish(self._solver.x)
        else:
            self.responses.correct(self._solver.x)
            self._corrected = True
        self._work = Work.NONE

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Begin anew from the present shape."""
        if self.corotated is not None:
            self.corotated.prescribed_changed(state, held)
            return
        self.responses.restart(state, held)
        self._begin_anew(state)

    def topology_changed(self, change: EditChange, state: State) -> None:
        """Follow an edit; what was known is where further solutions start from."""
        self.springs.follow(change)
        if self.corotated is not None:
            self.corotated.follow(change, state)
            return
        self.stiffness.follow(change)
        self._solver.follow(change.copied_nodes, change.copy_parents)
        if self.mesh.node_capacity > len(self._all):
            self._all = np.arange(self.mesh.node_capacity, dtype=np.int32)
        self.responses.follow(change, state)
        self._begin_anew(state)

    def _begin_anew(self, state: State) -> None:
        rows = self.mesh.node_rows
        self._prescribed = np.flatnonzero(state.prescribed[:rows]).astype(np.int32)
        self._work = Work.NONE
        self._corrected = False
        self._foresees = bool(self.values["foresight"])

    def forces(self, state: State, rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Internal elastic forces on nodes [N], shape (len(rows), 3)."""
        if self.corotated is not None:
            return self.corotated.forces(state, rows)
        out = np.zeros((len(rows), 3))
        forces_at(np.asarray(rows, np.int32), self.stiffness.rows, state.displacement, out)
        return out

    def residual(self, state: State) -> float:
        """Largest internal force on a free node [N]."""
        if self.corotated is not None:
            return self.corotated.largest_residual(state)
        free = self._all[: self.mesh.node_rows][~state.prescribed[: self.mesh.node_rows]]
        _, largest = squared_forces(free, self.stiffness.rows, state.displacement)
        return math.sqrt(largest)
