"""What the study of fits fits: models to themselves and to finite elements, on a pulled wall."""

from __future__ import annotations

from dataclasses import dataclass

from tissue_sim.compare.fit.cma_es import CmaEs
from tissue_sim.compare.fit.evolutionary import Evolutionary
from tissue_sim.compare.fit.problem import Problem, case_of
from tissue_sim.compare.fit.space import Space
from tissue_sim.compare.fit.strategy import Strategy
from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.organs import load_organ
from tissue_sim.compare.sources.motions import motion
from tissue_sim.compare.subject import parse_subject
from tissue_sim.compare.trajectory import simulate

REFERENCE = "finite_element@rest"
"""Finite elements at equilibrium in every frame, as in the thesis."""


@dataclass(frozen=True)
class SelfFit:
    """A model that is fitted to itself.

    Attributes:
        name: Name for people.
        subject: The model with the values that are to be found again.
        ranges: Where they are looked for.
        product: Values of which only the product matters.
    """

    name: str
    subject: str
    ranges: tuple[str, ...]
    product: tuple[str, ...] = ()


THESIS = SelfFit(
    "quasi-static, as in the thesis",
    "quasi_static:levels=10000,keep_until_rest=0,force_step=0.2,springs.stiffness=0.2@1.9",
    ("force_step=0.01..1", "springs.stiffness=0.01..1"),
    ("force_step", "springs.stiffness"),
)
"""The thesis' check: fitted to itself at (0.2, 0.2) (THESIS.md, section 7)."""

SELF_FITS = (
    THESIS,
    SelfFit("lr", "lr:step=1.2,linear_factor=0.05@2", ("step=0.1..1.99", "linear_factor=0..0.3")),
    SelfFit(
        "spring-mass",
        "spring_mass:mass_scaling=2,time_step=0.002,damping=0.067,springs.stiffness=0.5@2.9",
        ("damping=0..0.5", "springs.stiffness=0.05..20:log"),
    ),
)


@dataclass(frozen=True)
class Size:
    """How much is computed.

    Attributes:
        nodes: Nodes of the wall along its sides.
        seconds: Pull and time without motion after it [s].
        seeds: Seeds of the thesis' check; the other models take the first one.
        candidates, generations: Of each strategy.
        processes: Processes that a fit is timed with, beside none.
    """

    nodes: tuple[int, int, int] = (17, 26, 2)
    seconds: tuple[float, float] = (1.5, 3.0)
    seeds: tuple[int, ...] = (1, 2, 3, 4, 5)
    candidates: tuple[int, int] = (40, 12)
    generations: tuple[int, int] = (30, 60)
    processes: int = 2

    def strategy(self, name: str, space: Space, seed: int) -> tuple[Strategy, int]:
        """A strategy by name, and its generations."""
        if name == "ea":
            return Evolutionary(space.size, seed, self.candidates[0]), self.generations[0]
        return CmaEs(space.size, seed, self.candidates[1]), self.generations[1]


QUICK = Size((5, 6, 2), (0.3, 0.2), (1,), (8, 6), (4, 6))


def self_problem(fit: SelfFit, size: Size) -> Problem:
    """A model to be fitted to itself under an oblique pull of the wall."""
    subject = parse_subject(fit.subject)
    organ, pull = _pulled_wall(size)
    case = case_of(organ, pull, simulate(subject, organ, pull))
    return Problem(organ, subject, Space.parse(*fit.ranges), (case,))


def exact_problem(size: Size) -> Problem:
    """The thesis' quasi-static model, to be fitted to finite elements at equilibrium."""
    organ, pull = _pulled_wall(size)
    case = case_of(organ, pull, simulate(parse_subject(REFERENCE), organ, pull))
    return Problem(organ, parse_subject(THESIS.subject), Space.parse(*THESIS.ranges), (case,))


def _pulled_wall(size: Size) -> tuple[Organ, Interaction]:
    columns, rows, layers = size.nodes
    organ = load_organ("wall", parameters={"columns": columns, "rows": rows, "layers": layers})
    pull, hold = size.seconds
    return organ, motion("oblique", organ, pull_seconds=pull, hold_seconds=hold)
