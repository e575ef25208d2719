"""Sweeps with momentum, with Chebyshev's method and without either; see docs/acceleration.md."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.bench import machine
from tissue_sim.elastic import registry
from tissue_sim.elastic.mesh_model import MeshModel
from tissue_sim.elastic.model import Material, State
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.model_study import Pull, pull_of

GEOMETRIES = ("wall", "heart")
MODELS = ("quasi_static", "vertex_block_descent")
VARIANTS: tuple[dict[str, float], ...] = (
    {},
    {"momentum": 0.9},
    {"momentum": 0.95},
    {"momentum": 0.97},
    {"chebyshev": 0.95},
    {"chebyshev": 0.99},
    {"chebyshev": 0.998},
)
SWEEPS = 300
COUNTS = (10, 30, 100, 300)
"""Sweeps after which the error is told."""
REACHED = (0.1, 0.01)
"""Errors whose time is told."""
REFERENCE_SWEEPS = 3000
REFERENCE_MOMENTUM = {"wall": 0.95, "heart": 0.97}


@dataclass(frozen=True)
class Row:
    """Sweeps of a pull in one jump.

    Attributes:
        geometry: Name of the geometry.
        model: Name of the model.
        parameters: What accelerates; nothing: none.
        errors: After each sweep: norm of the distance from the converged shape over the norm of
            that shape.
        ms: Median processor time of a sweep [ms].
    """

    geometry: str
    model: str
    parameters: dict[str, float]
    errors: tuple[float, ...]
    ms: float

    @property
    def label(self) -> str:
        """What accelerates, for people."""
        return ", ".join(f"{key} {value:g}" for key, value in self.parameters.items()) or "none"

    def sweeps_to(self, error: float) -> int | None:
        """Sweeps after which the error stays below a bound; None: not within `SWEEPS`."""
        above = np.flatnonzero(np.array(self.errors) > error)
        last = int(above[-1]) + 1 if len(above) else 0
        return last + 1 if last < len(self.errors) else None


@dataclass
class Organ:
    """An organ that is held and pulled.

    Attributes:
        pull: What is held and where it goes.
        springs: Its network.
        ends: Converged shapes by model [m], shape (node_rows, 3); those asked for so far.
    """

    pull: Pull
    springs: SpringNetwork
    ends: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    @classmethod
    def of(cls, geometry: str) -> Organ:
        """The organ of this name."""
        pull = pull_of(geometry)
        return cls(pull, SpringNetwork(pull.mesh, Material()))

    def held(self, model: str, parameters: dict[str, float]) -> tuple[MeshModel, State]:
        """A model that holds it, still at rest."""
        values = registry.checked_parameters(model, parameters)
        built = registry.MODELS[model](self.pull.mesh, Material(), values, self.springs)
        state = State(self.pull.mesh)
        built.prescribed_changed(state, self.pull.held[:0])
        state.prescribed[self.pull.held] = True
        built.prescribed_changed(state, self.pull.held)
        return built, state

    def place(self, state: State, share: float) -> None:
        """Put what is held at a share of the pull."""
        state.displacement[self.pull.held] = share * self.pull.vector

    def end_of(self, model: str) -> NDArray[np.float64]:
        """The shape that sweeps end in [m], shape (node_rows, 3)."""
        if model not in self.ends:
            momentum = REFERENCE_MOMENTUM[self.pull.geometry]
            built, state = self.held(model, {"levels": float(WHOLE_ORGAN), "momentum": momentum})
            self.place(state, 1.0)
            for _ in range(REFERENCE_SWEEPS):
                built.step(state)
            rows = self.pull.mesh.node_rows
            self.ends[model] = state.displacement[:rows].astype(np.float64)
        return self.ends[model]

    def error(self, state: State, end: NDArray[np.float64]) -> float:
        """Norm of the distance from a shape over the norm of that shape."""
        rows = self.pull.mesh.node_rows
        return float(np.linalg.norm(state.displacement[:rows] - end) / np.linalg.norm(end))


def accelerated(
    organ: Organ, model: str, parameters: dict[str, float], sweeps: int = SWEEPS
) -> Row:
    """Pull in one jump and sweep.

    Args:
        organ: What is pulled.
        model: Name of the model.
        parameters: What accelerates.
        sweeps: How many.
    """
    plain = {"levels": float(WHOLE_ORGAN), "momentum": 0.0, "chebyshev": 0.0}
    built, state = organ.held(model, plain | parameters)
    end = organ.end_of(model)
    built.step(state)
    organ.place(state, 1.0)
    errors, seconds = [], []
    for _ in range(sweeps):
        begin = time.thread_time()
        built.step(state)
        seconds.append(time.thread_time() - begin)
        errors.append(float(f"{organ.error(state, end):.4g}"))
    return Row(
        organ.pull.geometry, model, parameters, tuple(errors), 1e3 * float(np.median(seconds))
    )


def rows_of(organ: Organ, models: Iterable[str] = MODELS) -> Iterator[Row]:
    """Every variant of every model."""
    for model in models:
        for parameters in VARIANTS:
            yield accelerated(organ, model, dict(parameters))


def run(
    out: Path | None,
    geometries: Iterable[str] = GEOMETRIES,
    say: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Measure accelerations and predictors.

    Args:
        out: File to write; None writes nothing.
        geometries: What to pull.
        say: Called with a line as each row is ready.
    """
    from tissue_sim import prediction_study

    registry.warm_up()
    rows, frames, responses = [], [], []
    for geometry in geometries:
        organ = Organ.of(geometry)
        for row in rows_of(organ):
            rows.append(row)
            say(f"{geometry}, {row.model}, {row.label}: {row.errors[-1]:.2g} of the shape is left")
        for predicted in prediction_study.rows_of(organ):
            frames.append(predicted)
            say(str(predicted))
        for response in prediction_study.responses_of(organ):
            responses.append(response)
            say(str(response))
    result = {
        "machine": machine(),
        "sweeps": [asdict(row) for row in rows],
        "frames": [asdict(row) for row in frames],
        "responses": [asdict(row) for row in responses],
    }
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps(result) + "\n", encoding="utf-8")
    return result


def as_markdown(result: dict[str, Any]) -> str:
    """The accelerations as a table."""
    after = "".join(f" after {count} |" for count in COUNTS)
    reached = "".join(f" sweeps to {error:.0%} | ms to {error:.0%} |" for error in REACHED)
    lines = [
        f"| | | acceleration |{after} ms a sweep |{reached}",
        "|---" * (4 + len(COUNTS) + 2 * len(REACHED)) + "|",
    ]
    for values in result["sweeps"]:
        row = Row(**values)
        cells = [row.geometry, f"`{row.model}`", row.label]
        cells += [f"{row.errors[count - 1]:.2%}" for count in COUNTS] + [f"{row.ms:.2f}"]
        for error in REACHED:
            sweeps = row.sweeps_to(error)
            cells += (
                [f"> {SWEEPS}", ""] if sweeps is None else [str(sweeps), f"{sweeps * row.ms:.0f}"]
            )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)
