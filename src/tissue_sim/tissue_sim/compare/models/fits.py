"""Parameters with which models come closest to finite elements, for rows beside the defaults.

Each is fitted once: on the wall, pulled obliquely, with the steps that a few milliseconds a frame
buy. Other motions, the heart and other budgets then show how far such parameters carry.
"""

from __future__ import annotations

from dataclasses import dataclass

from tissue_sim.compare.fit.cma_es import CmaEs
from tissue_sim.compare.fit.problem import Problem, case_of
from tissue_sim.compare.fit.search import search
from tissue_sim.compare.fit.space import Space
from tissue_sim.compare.fit.workers import workers_of
from tissue_sim.compare.models.step_cost import bought, step_cost
from tissue_sim.compare.models.trial import Trial
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.reference_cache import Say
from tissue_sim.compare.subject import Subject
from tissue_sim.elastic.ordering import WHOLE_ORGAN

ORGAN, MOTION, BUDGET_MS, REFERENCE = "wall", "oblique", 4.0, "linear"
"""What is fitted to."""

SEED, POPULATION, GENERATIONS = 1, 10, 12

ALL = {"levels": float(WHOLE_ORGAN)}
"""Value with which a pull reaches the whole organ."""

LIMITS = ("stretch=0.01..2:log", "compression=0.01..0.9:log", "shear=0.01..2:log")


@dataclass(frozen=True)
class Fit:
    """What is fitted of a model.

    Attributes:
        subject: The model, and what is not fitted.
        space: What is.
    """

    subject: Subject
    space: Space


FITS = (
    Fit(
        Subject("vertex_block_descent", ALL, label="vertex_block_descent, fitted"),
        Space.parse("step=0.5..1.3", "momentum=0..0.98", "material.poisson_ratio=0..0.49"),
    ),
    Fit(Subject("quasi_static", ALL, label="quasi_static, fitted"), Space.parse("step=0.01..1.9")),
    Fit(
        Subject("lr", ALL, label="lr, fitted"),
        Space.parse("step=0.01..1.9", "linear_factor=0.0001..0.9:log"),
    ),
    Fit(Subject("spring_mass", label="spring_mass, fitted"), Space.parse("damping=0.001..0.9:log")),
    Fit(Subject("chain_mail", label="chain_mail, fitted"), Space.parse(*LIMITS)),
    Fit(Subject("voxel_chain_mail", label="voxel_chain_mail, fitted"), Space.parse(*LIMITS)),
)


def fitted(fit: Fit, organ: Organ, say: Say) -> dict[str, float]:
    """The best values of a model, beside those that are not fitted.

    Args:
        fit: What to fit.
        organ: The organ to fit on.
        say: Told how far it is.
    """
    trial = Trial.of(organ, MOTION, (REFERENCE,), say)
    case = case_of(organ, trial.interaction, trial.references[REFERENCE])
    say(f"{organ.name}, {MOTION}: values of {fit.subject.name}")
    cost = step_cost(fit.subject, organ, trial.interaction, BUDGET_MS)
    share = bought(fit.subject, cost, BUDGET_MS, trial.interaction.rate_hz)
    problem = Problem(organ, share.subject, fit.space, (case,))
    with workers_of(problem) as workers:
        strategy = CmaEs(fit.space.size, SEED, POPULATION)
        found = search(problem, strategy, workers, GENERATIONS)
    return {**fit.subject.values, **found.best.values}
