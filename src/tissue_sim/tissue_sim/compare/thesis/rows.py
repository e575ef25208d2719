"""The thesis' table: each model, what it fitted, and what it found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from tissue_sim.compare.effort import Effort
from tissue_sim.compare.fit.space import Space
from tissue_sim.compare.machine import FRAME_HZ, THESIS_FPS
from tissue_sim.compare.subject import Subject
from tissue_sim.elastic.ordering import WHOLE_ORGAN

WORST = 0.2023
"""The thesis' difference where only held nodes move, in its own unit."""

VERLET_STEP = 1.0 / 60.0
"""Time step of the dynamic model here [s]; its nodes weigh the square of it [kg].

So h^2 / m is 1 m/N and springs.stiffness is h^2 k / m, on which alone Verlet's method depends.
"""

SWEEPS: Mapping[str, float] = {
    "levels": WHOLE_ORGAN, "keep_until_rest": 0.0, "springs.stiffness": 1.0,
}  # fmt: skip
"""Sweeps of the thesis over the whole wall: with k = 1 N/m, force_step is its step x stiffness."""

MASSES: Mapping[str, float] = {
    "time_step": VERLET_STEP, "mass_scaling": 2.0, "springs.node_mass": VERLET_STEP**2,
}  # fmt: skip


@dataclass(frozen=True)
class Row:
    """A row of the thesis' table.

    Attributes:
        name: Name for people.
        thesis: The thesis' difference, over that of the worst; None: it has no figure.
        model: Name of the model; empty: nothing moves but what is held.
        values: What is not fitted.
        fitted: Ranges of what is, as `Space.parse` reads them.
        found: Values that the thesis found, by the same names.
        rate: Key of `THESIS_FPS`; empty: to equilibrium in every frame.
        connected: Whether it runs on connected surfaces.
        repeats: Whether it matters that springs are repeated for each element.
        note: What people should know of it.
    """

    name: str
    thesis: float | None
    model: str
    values: Mapping[str, float] = field(default_factory=dict)
    fitted: tuple[str, ...] = ()
    found: Mapping[str, float] = field(default_factory=dict)
    rate: str = ""
    connected: bool = False
    repeats: bool = True
    note: str = ""

    @property
    def space(self) -> Space | None:
        """What is fitted; None: nothing."""
        return Space.parse(*self.fitted) if self.fitted else None

    @property
    def thesis_fps(self) -> float | None:
        """The thesis' frames a second on the wall; None: it has no figure."""
        return THESIS_FPS.get(self.rate)

    def steps(self, speed: float = 1.0) -> float | None:
        """Steps in a frame at so many times the thesis' speed; None: to equilibrium."""
        return round(THESIS_FPS[self.rate] / FRAME_HZ, 1) * speed if self.rate else None

    def subject(self, speed: float = 1.0) -> Subject:
        """Its model before anything is fitted."""
        steps = self.steps(speed)
        effort = Effort(to_rest=1e-7) if steps is None else Effort(steps=steps)
        return Subject(self.model, dict(self.values), effort, self.name)


_STEP = "force_step=0.005..1:log"
_LIMIT = "linear_factor=0.0001..0.3:log"

ROWS = (
    Row("only the held nodes move", 1.0, "", note="the worst that makes sense"),
    Row(
        "quasi-static, connected surfaces, one stiffness", 0.0661307 / 0.202279, "quasi_static",
        SWEEPS, ("force_step=0.01..2:log",), {"force_step": 0.967284 * 0.402214},
        "quasi_static on connected surfaces", connected=True,
    ),
    Row(
        "quasi-static, connected surfaces, two stiffnesses", 0.0639859 / 0.202279, "quasi_static",
        SWEEPS, ("force_step=0.01..2:log", "springs.connecting=0.1..30:log"),
        {"force_step": 1.10633 * 0.197968, "springs.connecting": 0.755308 / 0.197968},
        "quasi_static on connected surfaces", connected=True,
        note="springs.connecting: stiffness of connecting springs over that of the surfaces",
    ),
    Row(
        "relaxation only", 0.0622297 / 0.202279, "relaxation", {}, (_LIMIT, "passes=1..3"),
        {"linear_factor": 0.000351211, "passes": 1.0}, "relaxation", repeats=False,
    ),
    Row(
        "quasi-static, tetrahedra", 0.05905 / 0.202279, "quasi_static", SWEEPS, (_STEP,),
        {"force_step": 0.20286 * 0.490712}, "quasi_static",
        note="force_step: the thesis' step x stiffness, of which only the product matters",
    ),
    Row(
        "dynamic, tetrahedra", 0.0555 / 0.202279, "spring_mass", MASSES,
        ("springs.stiffness=0.005..1:log", "damping=0..0.5"),
        {"springs.stiffness": 0.589101**2 * 0.740875, "damping": 0.0665089}, "spring_mass",
        note="springs.stiffness: the thesis' step^2 x stiffness, its masses taken as 1",
    ),
    Row(
        "quasi-static + relaxation, up to 15 passes", 0.0497 / 0.202279, "lr", SWEEPS,
        (_STEP, _LIMIT, "passes=1..15"),
        {"force_step": 0.0542248 * 0.446545, "linear_factor": 0.00507468, "passes": 10.0},
        "quasi_static with relaxation",
        note="the thesis' table has 10 passes, its text 11",
    ),
    Row(
        "quasi-static + relaxation, up to 3 passes", 0.0494 / 0.202279, "lr", SWEEPS,
        (_STEP, _LIMIT, "passes=1..3"),
        {"force_step": 0.31525 * 0.490227, "linear_factor": 0.0235962, "passes": 1.0},
        "quasi_static with relaxation",
    ),
    Row(
        "quasi-static at full equilibrium", 0.0482 / 0.202279, "quasi_static",
        {**SWEEPS, "step": 1.5, "momentum": 0.9},
        note="not real time in the thesis",
    ),
    Row(
        "CG finite elements", None, "finite_element", rate="finite_element", repeats=False,
        note="the thesis has a curve only: behind springs for 4 to 5 s, exact after about 18 s; "
        "ours keeps the response to the hold's motion and needs it once",
    ),
)  # fmt: skip
"""The table of THESIS.md, section 7, and the model that the thesis' figure 9.13 shows besides."""
