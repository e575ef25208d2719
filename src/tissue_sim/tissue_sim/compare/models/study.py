"""Every model under five interactions at equal cost per frame; see docs/model_errors.md.

python3 -m tissue_sim.compare.models.study --out docs/results/model_errors.json
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

from tissue_sim.bench import machine, measure_triad
from tissue_sim.compare.models.fits import ALL, FITS, ORGAN, Fit, fitted
from tissue_sim.compare.models.step_cost import StepCost, step_cost
from tissue_sim.compare.models.table import as_markdown, into_page
from tissue_sim.compare.models.trial import Trial
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.organs import load_organ
from tissue_sim.compare.reference_cache import Say
from tissue_sim.compare.sources.motions import MOTIONS, motion
from tissue_sim.compare.subject import Subject
from tissue_sim.elastic import registry
from tissue_sim.whole_files import write_json

ORGANS = ("wall", "heart")
BUDGETS_MS = (1.0, 4.0, 16.0)
"""Time a frame [ms]."""

LEAST_MS, MOST_MS = 0.1, 1000.0
"""Budgets that are possible [ms]."""

COST_MOTION = "oblique"
"""Through it the cost of a step is measured."""

SUBJECTS = (
    Subject("finite_element"),
    Subject("finite_element", {"corotated": 1.0}, label="finite_element, corotated"),
    Subject("vertex_block_descent"),
    Subject("vertex_block_descent", ALL, label="vertex_block_descent, all levels"),
    Subject(
        "vertex_block_descent", {"dynamic": 1.0, "iterations": 1.0, "time_step": 1.0 / 30.0},
        label="vertex_block_descent, in time",
    ),
    Subject("quasi_static"),
    Subject("quasi_static", ALL, label="quasi_static, all levels"),
    Subject("quasi_static", ALL | {"momentum": 0.95}, label="quasi_static, momentum"),
    Subject("lr"),
    Subject("lr", ALL, label="lr, all levels"),
    Subject("relaxation"),
    Subject("spring_mass"),
    Subject("chain_mail"),
    Subject("voxel_chain_mail"),
)  # fmt: skip
"""All models; parameters that are not named have their defaults."""

Result = dict[str, Any]


class Study:
    """The rows so far, in a file that is whole at any time.

    Attributes:
        result: Machine, fitted values, cost of the steps and rows, as in the file.
    """

    def __init__(self, out: Path | None, resume: bool, say: Say = lambda line: None) -> None:
        """Begin, or go on with what a file holds.

        Args:
            out: File to write as rows are ready; None writes nothing.
            resume: Whether to keep what is in it.
            say: Told what is being done.

        Raises:
            ValueError: The file was measured on another processor.
        """
        self._out, self._say = out, say
        self.result: Result = {
            "machine": machine(), "fitted": {}, "organs": {}, "rows": []
        }  # fmt: skip
        if out is None or not resume or not out.is_file():
            return
        there = json.loads(out.read_text(encoding="utf-8"))
        ours, theirs = (each["machine"]["processor"] for each in (self.result, there))
        if ours != theirs:
            raise ValueError(
                f"{out} was measured on {theirs}, this is {ours}: equal cost is that of one "
                "machine; begin anew, without --resume"
            )
        self.result = there

    @property
    def subjects(self) -> tuple[Subject, ...]:
        """What is judged: `SUBJECTS`, and what has been fitted."""
        found = self.result["fitted"].items()
        return (
            *SUBJECTS,
            *(Subject(of["model"], of["values"], label=label) for label, of in found),
        )

    def fit(self, fits: Sequence[Fit]) -> None:
        """Fit what has not been fitted yet; it is judged like any other subject from then on."""
        for fit in fits:
            subject, known = fit.subject, self.result["fitted"]
            if subject.name not in known:
                values = fitted(fit, load_organ(ORGAN), self._say)
                known[subject.name] = {"model": subject.model, "values": values}
                self._write()

    def add(self, name: str, interactions: Sequence[str], budgets_ms: Sequence[float]) -> None:
        """Play what is missing of interactions with an organ to every model.

        Raises:
            ValueError: There is no such organ or interaction.
        """
        organ = load_organ(name)
        costs = self._costs(organ, budgets_ms)
        keys = ("organ", "interaction", "label", "budget_ms")
        done = {tuple(row[key] for key in keys) for row in self.result["rows"]}
        for interaction in interactions:
            todo = [
                (subject, budget)
                for budget in budgets_ms
                for subject in self.subjects
                if (organ.name, interaction, subject.name, budget) not in done
            ]
            if not todo:
                continue
            trial = Trial.of(organ, interaction, say=self._say)
            for place, (subject, budget) in enumerate(todo, 1):
                row_of = f"{organ.name}, {interaction}: row {place} of {len(todo)}"
                self._say(f"{row_of}, {subject.name}, {budget:g} ms")
                row = trial.judged(subject, costs[subject.name, budget], budget)
                self.result["rows"].append(asdict(row))
                self._write()

    def _costs(
        self, organ: Organ, budgets_ms: Sequence[float]
    ) -> dict[tuple[str, float], StepCost]:
        """What steps cost by label and budget; those are measured that are not known yet."""
        mesh = organ.mesh
        about = {"nodes": int(mesh.node_alive.sum()), "elements": int(mesh.element_alive.sum())}
        known = self.result["organs"].setdefault(organ.name, {**about, "costs": []})["costs"]
        costs = {(each["label"], each["budget_ms"]): each["cost"] for each in known}
        pull = motion(COST_MOTION, organ)
        for subject in self.subjects:
            new = [budget for budget in budgets_ms if (subject.name, budget) not in costs]
            triad = 1e-9 * measure_triad() if new else 0.0
            for budget in new:
                self._say(f"{organ.name}: cost of a step of {subject.name} at {budget:g} ms")
                cost = asdict(step_cost(subject, organ, pull, budget))
                entry = {"label": subject.name, "budget_ms": budget, "cost": cost}
                known.append({**entry, "triad_GBps": triad})
                costs[subject.name, budget] = cost
                self._write()
        return {key: StepCost(**cost) for key, cost in costs.items()}

    def _write(self) -> None:
        if self._out is not None:
            write_json(self._out, self.result)


def run(
    out: Path | None,
    organs: Sequence[str] = ORGANS,
    interactions: Sequence[str] = tuple(MOTIONS),
    budgets_ms: Sequence[float] = BUDGETS_MS,
    resume: bool = False,
    say: Say = lambda line: None,
    fits: Sequence[Fit] = FITS,
) -> Result:
    """Play every interaction with every organ to every model, with every budget.

    Args:
        out: File to write as rows are ready; None writes nothing.
        organs: Names of organs.
        interactions: Names of motions.
        budgets_ms: Time a frame [ms].
        resume: Whether to keep what is in the file.
        say: Told what is being done.
        fits: What is fitted first, to be judged with the others.

    Raises:
        ValueError: A name is unknown, a budget is out of range, or the file was measured on another
            processor.
    """
    for budget in budgets_ms:
        if not LEAST_MS <= budget <= MOST_MS:
            raise ValueError(
                f"a budget of {budget:g} ms a frame is out of range; allowed: {LEAST_MS:g} to "
                f"{MOST_MS:g} ms"
            )
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
    study = Study(out, resume, say)
    study.fit(fits)
    for organ in organs:
        study.add(organ, interactions, budgets_ms)
    return study.result


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="errors of every model at equal cost per frame")
    parser.add_argument("--out", type=Path, help="JSON file; rows are in it as they are ready")
    parser.add_argument("--picture", type=Path, help="PNG file to draw the errors in")
    parser.add_argument("--page", type=Path, help="page to put the tables in")
    parser.add_argument("--organ", choices=ORGANS, action="append", help="default: all")
    parser.add_argument("--budget", type=float, action="append", help="ms a frame; default: all")
    parser.add_argument("--quick", action="store_true", help="the wall, pulled obliquely, no fits")
    parser.add_argument("--resume", action="store_true", help="keep the rows that are in the file")
    chosen = parser.parse_args()
    organs = ("wall",) if chosen.quick else chosen.organ or ORGANS
    interactions = (COST_MOTION,) if chosen.quick else tuple(MOTIONS)
    console = Console(stderr=True)
    try:
        with console.status("compiling") as status:
            registry.warm_up()
            result = run(
                chosen.out, organs, interactions, chosen.budget or BUDGETS_MS, chosen.resume,
                status.update, () if chosen.quick else FITS,
            )  # fmt: skip
    except ValueError as error:
        parser.error(str(error))
    if chosen.picture is not None:
        from viz_bridge.model_error_curves import draw_model_errors

        draw_model_errors(result, chosen.picture)
    if chosen.page is not None:
        text = into_page(chosen.page.read_text(encoding="utf-8"), as_markdown(result))
        chosen.page.write_text(text, encoding="utf-8")
    print(as_markdown(result))


if __name__ == "__main__":
    main()
