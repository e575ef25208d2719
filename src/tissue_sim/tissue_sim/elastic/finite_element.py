"""Linear static finite elements, exact in every frame once a hold's responses are known."""

from __future__ import annotations

import math
from enum import Enum, auto
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.conjugate_gradients import ConjugateGradients
from tissue_sim.elastic.corotated import Corotated
from tissue_sim.elastic.direct_solver import DirectSolver
from tissue_sim.elastic.loose_parts import LooseParts
from tissue_sim.elastic.mesh_model import MeshModel
from tissue_sim.elastic.model import Material, Parameter, State
from tissue_sim.elastic.region_solver import RegionSolver
from tissue_sim.elastic.responses import Responses
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.stiffness import Stiffness
from tissue_sim.elastic.stitch_blocks import StitchBlocks
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.aggregates import patches_of
from tissue_sim.kernels.conjugate_lanes import add_lanes
from tissue_sim.kernels.extrapolation import add_difference
from tissue_sim.kernels.lanes import LANES
from tissue_sim.kernels.responses import add_share
from tissue_sim.kernels.stiffness import forces_at, squared_forces

SELDOM = 8
"""Checks of a lane between two measurements of the force on prescribed nodes."""

YOUNG = 16
"""Iterations after which a lane is not given up any more: its work would be lost."""


class Work(Enum):
    """What a lane of the solver is for."""

    NONE = auto()
    RESPONSE = auto()
    """A motion of what is held that has not been met before."""
    CORRECTION = auto()
    """The shape that was found at a grab, a release or a cut."""


class FiniteElement(MeshModel):
    """K u = 0 in the free nodes, with the displacements of fixed and held nodes prescribed.

    The solution is linear in the motion of what is held. Every motion that is new (orthogonal to
    those met since the grab) is solved for by conjugate gradients, which go on from frame to frame,
    and its response is kept; every further pose of the same hold is a sum of responses. The solver
    works in four lanes at once: on motions, on what is not in equilibrium after a grab, a release
    or a cut, and on motions that may come.

    With `corotated` strain is measured in each element's own frame and every pose is solved anew;
    see `Corotated` and docs/corotated.md.

    Limitations: large rotations swell, unless corotated; see docs/finite_element.md.
    """

    anisotropic: ClassVar[bool] = True
    needs_tetrahedra: ClassVar[bool] = True
    name: ClassVar[str] = "finite_element"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter(
            "tolerance", 1e-4, 1e-12, 0.1, "",
            "residual force in free nodes over the force on prescribed nodes that counts as solved",
        ),
        Parameter("rest_tolerance", 1e-8, 1e-14, 1e-3, "m", "motion that counts as none"),
        Parameter(
            "corotated", 0, 0, 1, "", "1: strain is measured in turned elements", integer=True
        ),
        Parameter(
            "foresight", 1, 0, 1, "",
            "1: lanes that are free solve for motions before they occur",
            integer=True,
        ),
        Parameter(
            "direct", 0, 0, 1, "",
            "1: the matrix is factorised beforehand; only until the first cut",
            integer=True,
        ),
        Parameter(
            "interest_radius", 0.0, 0.0, 10.0, "m",
            "of the region of interest; outside of it all is precomputed and nothing can be cut; "
            "0: none",
        ),
        Parameter("interest_x", 0.0, -10.0, 10.0, "m", "its centre at rest"),
        Parameter("interest_y", 0.0, -10.0, 10.0, "m", "its centre at rest"),
        Parameter("interest_z", 0.0, -10.0, 10.0, "m", "its centre at rest"),
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
        self._direct: DirectSolver | RegionSolver | None = None
        self._refuse_combinations()
        if len(mesh.sutures) and (why := self._why_not_sewn()):
            raise ValueError(f"the tissue is sewn, and {why}")
        if self.values["corotated"]:
            self.corotated = Corotated(
                self.springs, self.values["tolerance"], self.values["rest_tolerance"]
            )
            return
        self.stiffness = Stiffness(self.springs)
        self._stitches = StitchBlocks(self.stiffness)
        self.responses = Responses(mesh.node_capacity, self.springs.dtype)
        self._solver = ConjugateGradients(self.stiffness)
        self._loose, self._at_rest = LooseParts(mesh), np.zeros((0, 3), self.springs.dtype)
        self._all = np.arange(mesh.node_capacity, dtype=np.int32)
        self._prescribed, self._given = np.empty(0, dtype=np.int32), mesh.fixed.copy()
        self._work = [Work.NONE] * LANES
        self._shares = np.zeros((1, 1, LANES), dtype=self.springs.dtype)
        self._forces, self._until_forces = np.zeros(LANES), 0
        self._corrected = self._waits = self._foresees = self._guessed = False
        # Compiled, or loaded from the cache, here: not every step calls it.
        shape = self.responses.sum
        add_share(0, np.zeros(0, dtype=np.bool_), shape, 0.0, shape, shape)
        self._loose.hold_still(mesh.fixed, shape)
        self._loose.hold_still(mesh.fixed, self._solver.x[:, :, 0])
        if self.values["direct"]:
            self._direct = DirectSolver(self.stiffness)
        elif self.values["interest_radius"]:
            centre = np.array([self.values[f"interest_{axis}"] for axis in "xyz"])
            self._direct = RegionSolver(self.stiffness, centre, self.values["interest_radius"])

    def _refuse_combinations(self) -> None:
        wanted = ("corotated", "direct", "interest_radius")
        given = [name for name in wanted if self.values[name]]
        if len(given) > 1:
            raise ValueError(
                f"{given[0]} and {given[1]} do not go together: the matrix of turned elements "
                "changes all the time, and a region of interest is factorised by itself; allowed: "
                "one of them"
            )

    def _why_not_sewn(self) -> str:
        """Why there can be no stitches; "" if there can."""
        if self.values["interest_radius"]:
            return "interest_radius knows no stitches: outside of the region all is precomputed"
        if self.values["direct"]:
            return "direct = 1 knows no stitches: its factors are those of unsewn tissue"
        return ""

    def sewing_refusal(self) -> str:
        """A region of interest refuses stitches; direct factors end with the first of them."""
        return self._why_not_sewn() if self.values["interest_radius"] else ""

    def patch_refusal(self) -> str:
        """A region of interest refuses patches; direct factors end with the first of them."""
        if not self.values["interest_radius"]:
            return ""
        return "interest_radius knows no patches: outside of the region all is precomputed"

    @property
    def idle(self) -> bool:
        """Whether everything is solved for the present pose."""
        if self.corotated is not None:
            return self.corotated.settled
        known = self._corrected and not self._waits and not self._foresees
        return known and not any(self._solver.active)

    @property
    def coarse_bytes(self) -> int:
        """Memory that the coarse part of the preconditioner reads in an iteration at least."""
        return (self.corotated or self._solver).coarse_bytes

    def step(self, state: State) -> None:
        """One iteration of every lane that has work. Modifies the state in place."""
        if self.corotated is not None:
            self.corotated.step(state)
            return
        left = self.responses.follow_motion(state, self.mesh.node_rows)
        self._waits = left > self.values["rest_tolerance"]
        self._begin(state)
        self._guessed = False
        if not any(self._solver.active):
            if self.responses.changed:
                self._show(state)
            self._renew_stitches(state)
            return
        if self._direct is not None and self._direct.go_on():
            self._solve_directly(self._direct)
            self._show(state)
            return
        self._solver.iterate(state.prescribed)
        self._hold_still()
        self._show(state)
        for lane in np.flatnonzero(self._solver.active).tolist():
            if self._solved(lane, state):
                self._finish(lane)
        self._renew_stitches(state)

    def _hold_still(self) -> None:
        """Take the motions of loose parts as a whole out of all lanes: K does not notice them."""
        if len(self._loose):
            for lane in np.flatnonzero(self._solver.active).tolist():
                self._loose.hold_still(self._given, self._solver.x[:, :, lane])

    def _renew_stitches(self, state: State) -> None:
        """Take the stitches' load anew once the shape is corrected for the one before."""
        if not len(self._stitches):
            return
        if not self._corrected:
            if self._stitches.catch(state.displacement):
                self._restart_at(state)
            return
        tolerance, least = self.values["tolerance"], self.values["rest_tolerance"]
        renewed = self._stitches.renew(state.displacement, tolerance, least)
        if renewed == "load":
            self._corrected = False
        elif renewed:
            self._restart_at(state)

    def _solve_directly(self, direct: DirectSolver | RegionSolver) -> None:
        """Solve one motion, or correct the shape."""
        lane = int(np.flatnonzero(self._solver.active)[0])
        x = self._solver.x[:, :, lane]
        if self._work[lane] is Work.CORRECTION:
            x[:] = direct.change(self.responses.sum)
        else:
            x += direct.change(x)
        self._finish(lane)

    def _begin(self, state: State) -> None:
        """Give the lanes that are free something to do."""
        if self._waits and self.responses.full:
            self._restart_at(state)
        elif self._waits and (lane := self._lane(overtake=True)) is not None:
            self.responses.begin(lane)
            if self._guessed:
                self.responses.improve_guess(lane, state.displacement, self.mesh.node_rows)
            self._begin_lane(lane, Work.RESPONSE, self.responses.guess)
            self._waits = False
            self._foresees = bool(self.values["foresight"])
        if not self._corrected and Work.CORRECTION not in self._work:
            lane = self._lane(overtake=True)
            if lane is not None:
                self._begin_lane(lane, Work.CORRECTION, self.responses.sum)
        while self._foresees and not self._waits and (lane := self._lane()) is not None:
            self._foresees = self.responses.propose(self.mesh.rest)
            if self._foresees:
                self.responses.begin(lane, proposed=True)
                self._begin_lane(lane, Work.RESPONSE, self.responses.guess)

    def _lane(self, overtake: bool = False) -> int | None:
        """A free lane, or one whose motion matters less than what waits, which is given up."""
        if Work.NONE in self._work:
            return self._work.index(Work.NONE)
        lane = self.responses.overtaken() if overtake else None
        if lane is None or self._solver.iterations[lane] > YOUNG:
            return None
        self.responses.abandon(lane)
        self._work[lane] = Work.NONE
        return lane

    def _begin_lane(self, lane: int, work: Work, shape: NDArray[np.floating]) -> None:
        self._work[lane] = work
        if work is Work.RESPONSE:
            # No force would ever take out of a guess what moves a loose part as a whole.
            self._loose.hold_still(self._given, shape)
        self._solver.begin(lane, shape, change=work is Work.CORRECTION)
        if work is Work.CORRECTION and len(self._stitches):
            nodes = self._stitches.nodes
            free = ~np.isin(nodes, self._prescribed)
            self._solver.load(lane, nodes[free], self._stitches.load[free])
        self._until_forces = 0

    def _restart_at(self, state: State) -> None:
        self.responses.restart_at(state)
        self._begin_anew(state)

    def _show(self, state: State) -> None:
        """Write the shape as far as it is known."""
        rows, sum_ = self.mesh.node_rows, self.responses.sum
        if not any(self._solver.active):
            add_share(rows, state.prescribed, sum_, 0.0, sum_, state.displacement)
            return
        for lane, work in enumerate(self._work):
            share = 1.0 if work is Work.CORRECTION else 0.0
            if work is Work.RESPONSE:
                share = self.responses.share_of(lane)
            self._shares[0, 0, lane] = share
        add_lanes(rows, state.prescribed, sum_, self._shares, self._solver.x, state.displacement)

    def _solved(self, lane: int, state: State) -> bool:
        solver = self._solver
        if solver.stuck[lane]:
            return True
        if self._work[lane] is Work.CORRECTION:
            if solver.largest[lane] <= self.values["rest_tolerance"]:
                return True
            squared, _ = squared_forces(self._prescribed, self.stiffness.rows, state.displacement)
            force = math.sqrt(squared)
        else:
            force = self._prescribed_force(lane)
        return bool(solver.residual[lane] <= self.values["tolerance"] * force)

    def _prescribed_force(self, lane: int) -> float:
        """Norm of the force on prescribed nodes at the response of a lane [N]."""
        # It hardly changes any more when the residual is small.
        if self._until_forces == 0:
            self._solver.forces(self._prescribed, self._forces)
            self._until_forces = SELDOM
        self._until_forces -= 1
        return float(self._forces[lane])

    def _finish(self, lane: int) -> None:
        x = self._solver.x[:, :, lane]
        if self._work[lane] is Work.RESPONSE:
            self.responses.finish(lane, x)
        else:
            self.responses.correct(x)
            self._corrected = True
        self._leave(lane)

    def _leave(self, lane: int) -> None:
        self._solver.end(lane)
        self._work[lane] = Work.NONE

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Begin anew from the present shape."""
        if self.corotated is not None:
            self.corotated.prescribed_changed(state, held)
            return
        self._bind(state)
        arrays = self.springs.arrays
        patches = patches_of(held, arrays.start, arrays.degree, arrays.neighbour)
        self.responses.restart(state, held, patches)
        self._begin_anew(state)
        if self._direct is not None:
            self._direct.hold(held)

    @property
    def takes_guess(self) -> bool:
        """A response can begin anywhere; a corotated shape would have to be linearised anew."""
        return self.corotated is None

    def guess(
        self, state: State, before: NDArray[np.floating], after: NDArray[np.floating]
    ) -> None:
        """Where the response to a motion that is new begins; see `Model`.

        Known responses are exact. While others are being solved for, the shape on show is not one
        that a further one could begin from. What is known from before an edit is a better start.
        """
        known = self._corrected and Work.RESPONSE not in self._work
        known &= not self.responses.remembers or self._guessed
        if known:
            rows = self.mesh.node_rows
            nodes = self._all.view(np.uint32)
            add_difference(nodes, 0, rows, state.prescribed, before, after, state.displacement)
        self._guessed = known

    def refusal(self, nodes: NDArray[np.int32]) -> str:
        """A region of interest refuses what changes the outside of it; see `Model`."""
        return self._direct.refusal(nodes) if self._direct is not None else ""

    def topology_changed(self, change: EditChange, state: State) -> None:
        """Follow an edit; what was known is where further solutions start from."""
        self.springs.follow(change)
        if self.corotated is not None:
            self.corotated.follow(change, state)
            return
        self.stiffness.follow(change)
        self._loose.follow(change)
        self._bind(state)
        if self._direct is not None and (why := self._direct.follow(change)):
            self._direct = None
            self.events.append(f"finite_element: {why}")
        self._solver.follow(change.copied_nodes, change.copy_parents)
        if self.mesh.node_capacity > len(self._all):
            self._all = np.arange(self.mesh.node_capacity, dtype=np.int32)
        self.responses.follow(change, state)
        self._begin_anew(state)

    def _bind(self, state: State) -> None:
        """Follow stitches, and what keeps parts in place; see `LooseParts`.

        What moves a loose part as a whole moves nothing in K, that is by small angles from rest.
        """
        u = state.displacement
        self._stitches.sew(u)
        self._given = state.prescribed.copy()
        if len(self._at_rest) != len(u):
            self._at_rest = np.zeros_like(u)
        self._loose.follow_prescribed(self._at_rest, self._given)
        self.responses.strained = len(self._stitches) > 0 or bool(u[self._loose.nodes].any())

    def _begin_anew(self, state: State) -> None:
        rows = self.mesh.node_rows
        self._prescribed = np.flatnonzero(state.prescribed[:rows]).astype(np.int32)
        for lane in range(LANES):
            self._leave(lane)
        # Seen from rest, the present shape is the first guess of the first motion's response.
        self._corrected = self._guessed = self.responses.from_rest
        self._foresees = bool(self.values["foresight"])

    def forces(self, state: State, rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Internal elastic forces on nodes [N], shape (len(rows), 3)."""
        if self.corotated is not None:
            return self.corotated.forces(state, rows)
        out = np.zeros((len(rows), 3))
        forces_at(np.asarray(rows, np.int32), self.stiffness.rows, state.displacement, out)
        return out + self._stitches.load_at(rows)

    def residual(self, state: State) -> float:
        """Largest internal force on a free node [N]."""
        if self.corotated is not None:
            return self.corotated.largest_residual(state)
        free = self._all[: self.mesh.node_rows][~state.prescribed[: self.mesh.node_rows]]
        sewn = free[np.isin(free, self._stitches.nodes)]
        free = np.setdiff1d(free, sewn)
        _, largest = squared_forces(free, self.stiffness.rows, state.displacement)
        of_sewn = (self.forces(state, sewn) ** 2).sum(axis=1).max(initial=0.0)
        return math.sqrt(max(largest, float(of_sewn)))
