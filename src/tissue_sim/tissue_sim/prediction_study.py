"""A fast model as the predictor of a precise one: error and time of a frame, with and without."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.acceleration_study import Organ
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.predictor import Predictor, predictor_of

FRAMES, STILL = 30, 6
"""Frames during which the hold moves, and frames that follow."""
ALL = {"levels": float(WHOLE_ORGAN)}
PRECISE = {
    "vertex_block_descent": ALL,
    "quasi_static": ALL | {"momentum": 0.95},
}
STEPS = {"wall": (1, 2, 5, 10, 20), "heart": (1, 2, 5, 10)}
"""Steps of the precise model in a frame."""
AHEAD = (("", 0), ("lr", 1), ("lr", 5), ("finite_element", 1))
"""Predictors and their steps in a frame."""
ITERATIONS = (2, 5, 10, 20)
"""Iterations of finite elements after the first motion of a hold."""
EXACT_STEPS = 600


@dataclass(frozen=True)
class FrameRow:
    """A pull over `FRAMES` frames.

    Attributes:
        geometry: Name of the geometry.
        model: Name of the precise model.
        steps: Its steps in a frame.
        predictor: Name of the fast model; "": none.
        predictor_steps: Its steps in a frame.
        moving: Distance from the converged shape over the norm of that shape, when the pull ends.
        still: The same `STILL` frames later.
        ms: Median processor time of a frame, prediction included [ms].
        predictor_ms: Median processor time of the prediction [ms].
    """

    geometry: str
    model: str
    steps: int
    predictor: str
    predictor_steps: int
    moving: float
    still: float
    ms: float
    predictor_ms: float


@dataclass(frozen=True)
class ResponseRow:
    """The first motion after a grab, solved by finite elements, in one jump.

    Attributes:
        geometry: Name of the geometry.
        predictor: Name of the fast model; "": none.
        predictor_steps: Its steps before the first iteration.
        start: Distance from the exact shape over the norm of that shape after the prediction.
        errors: The same after `ITERATIONS` iterations.
        ms: Median processor time of an iteration [ms].
        predictor_ms: Processor time of the prediction [ms].
    """

    geometry: str
    predictor: str
    predictor_steps: int
    start: float
    errors: tuple[float, ...]
    ms: float
    predictor_ms: float


def rows_of(organ: Organ) -> Iterator[FrameRow]:
    """Every precise model with every predictor."""
    geometry = organ.pull.geometry
    for model in PRECISE:
        for steps in STEPS[geometry]:
            for predictor, ahead in AHEAD:
                yield pulled(organ, model, steps, predictor, ahead)


def pulled(organ: Organ, model: str, steps: int, predictor: str, ahead: int) -> FrameRow:
    """Pull over `FRAMES` frames and hold still.

    Args:
        organ: What is pulled.
        model: Name of the precise model.
        steps: Its steps in a frame.
        predictor: Name of the fast model; "": none.
        ahead: Its steps in a frame.
    """
    built, state = organ.held(model, PRECISE[model])
    fast = predictor_of(predictor, max(ahead, 1), built, organ.springs, _whole(predictor), state)
    if fast is not None:
        fast.prescribed_changed(state, organ.pull.held)
    seconds, predicting, errors = [], [], []
    for frame in range(1, FRAMES + STILL + 1):
        organ.place(state, min(frame / FRAMES, 1.0))
        begin = time.thread_time()
        if fast is not None:
            fast.predict(built, state)
        predicted = time.thread_time()
        for _ in range(steps):
            built.step(state)
        seconds.append(time.thread_time() - begin)
        predicting.append(predicted - begin)
        errors.append(organ.error(state, organ.end_of(model)))
    return FrameRow(
        organ.pull.geometry, model, steps, predictor, ahead, float(f"{errors[FRAMES - 1]:.4g}"),
        float(f"{errors[-1]:.4g}"), _ms(seconds[:FRAMES]), _ms(predicting[:FRAMES]),
    )  # fmt: skip


def _whole(predictor: str) -> dict[str, float]:
    return ALL if predictor == "lr" else {}


def _ms(seconds: list[float]) -> float:
    return round(1e3 * float(np.median(seconds)), 4)


def responses_of(organ: Organ) -> Iterator[ResponseRow]:
    """Finite elements' first motion, without a predictor and with `lr`."""
    built, state = organ.held("finite_element", {"tolerance": 1e-6})
    organ.place(state, 1.0)
    for _ in range(EXACT_STEPS):
        built.step(state)
    end = state.displacement[: organ.pull.mesh.node_rows].astype(np.float64)
    for predictor, ahead in (("", 0), ("lr", 5), ("lr", 50)):
        yield _response(organ, predictor, ahead, end)


def _response(organ: Organ, predictor: str, ahead: int, end: NDArray[np.float64]) -> ResponseRow:
    built, state = organ.held("finite_element", {"foresight": 0.0})
    # The grab itself is solved for before anything moves.
    for _ in range(ITERATIONS[-1]):
        built.step(state)
    organ.place(state, 1.0)
    seconds, errors = [], []
    if predictor:
        _, rest = organ.held("finite_element", {})
        fast = Predictor(predictor, ahead, organ.springs, _whole(predictor), rest)
        fast.prescribed_changed(rest, organ.pull.held)
    begin = time.thread_time()
    if predictor:
        fast.predict(built, state)
    predictor_ms = 1e3 * (time.thread_time() - begin)
    start = organ.error(state, end)
    for iteration in range(1, ITERATIONS[-1] + 1):
        begin = time.thread_time()
        built.step(state)
        seconds.append(time.thread_time() - begin)
        if iteration in ITERATIONS:
            errors.append(float(f"{organ.error(state, end):.4g}"))
    return ResponseRow(
        organ.pull.geometry, predictor, ahead, float(f"{start:.4g}"), tuple(errors), _ms(seconds),
        round(predictor_ms, 4),
    )  # fmt: skip


def frames_as_markdown(result: dict[str, Any]) -> str:
    """Precise models with and without predictors, as a table."""
    lines = [
        "| | | steps a frame | predictor | error when the pull ends | six frames later "
        "| ms a frame | of it predictor |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in (FrameRow(**values) for values in result["frames"]):
        ahead = f"`{row.predictor}`, {row.predictor_steps}" if row.predictor else "none"
        lines.append(
            f"| {row.geometry} | `{row.model}` | {row.steps} | {ahead} | {row.moving:.2%} "
            f"| {row.still:.2%} | {row.ms:.2f} | {row.predictor_ms:.2f} |"
        )
    return "\n".join(lines)


def responses_as_markdown(result: dict[str, Any]) -> str:
    """The first motion of finite elements, as a table."""
    after = "".join(f" after {count} |" for count in ITERATIONS)
    lines = [
        f"| | predictor | error at the start |{after} ms an iteration | ms of the predictor |",
        "|---" * (5 + len(ITERATIONS)) + "|",
    ]
    for row in (ResponseRow(**values) for values in result["responses"]):
        ahead = f"`{row.predictor}`, {row.predictor_steps}" if row.predictor else "none"
        errors = " | ".join(f"{error:.2%}" for error in row.errors)
        lines.append(
            f"| {row.geometry} | {ahead} | {row.start:.1%} | {errors} | {row.ms:.2f} "
            f"| {row.predictor_ms:.1f} |"
        )
    return "\n".join(lines)
