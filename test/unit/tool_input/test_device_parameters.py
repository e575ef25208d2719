"""Absurd numbers given to the nodes of devices: refused at once, with what is allowed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from tissue_sim.parameters import ParameterError, Spec
from tool_input import arm_parameters, joy_parameters
from tool_input.haptics import haptic_parameters

JOY = joy_parameters.SPECS
HAPTIC = haptic_parameters.SPECS
"""Those of an arm are among them."""
QUATERNIONS = ("camera_orientation", "base_orientation")
POSITIVE = (
    "linear_scale", "angular_scale", "slow_factor", "scale", "force_scale", "rate_hz", "max_force",
    "max_torque", "max_force_rate", "max_torque_rate", "max_stiffness", "fade", "force_timeout",
    "input_timeout",
)  # fmt: skip


def numbers(specs: tuple[Spec, ...]) -> list[Spec]:
    return [spec for spec in specs if spec.kind in ("integer", "double", "doubles")]


@pytest.mark.parametrize("spec", [*numbers(JOY), *numbers(HAPTIC)], ids=lambda spec: spec.name)
def test_what_is_no_number_or_absurdly_large_is_refused(spec: Spec) -> None:
    absurd = [math.nan, math.inf, -math.inf, 1e9, -1e9]
    if spec.name in POSITIVE:
        absurd += [0.0, -1.0]
    if spec.name in QUATERNIONS:
        absurd = absurd[:3]  # Its length is checked as a whole, see below.
    for value in absurd:
        with pytest.raises(ParameterError, match=rf"{spec.name} = .* allowed: ") as refusal:
            spec.checked([value] * spec.length if spec.kind == "doubles" else value)
        assert spec.name in QUATERNIONS or " from " in str(refusal.value)


@pytest.mark.parametrize(
    ("made", "specs", "values", "says"),
    [
        (joy_parameters.steering_of, JOY, {"workspace_max": [0.0, -1.0, 0.0]}, "less than"),
        (joy_parameters.steering_of, JOY, {"camera_orientation": [0.0] * 4}, "of length 1"),
        (arm_parameters.mapping_of, HAPTIC, {"workspace_min": [1.0, 1.0, 1.0]}, "less than"),
        (arm_parameters.mapping_of, HAPTIC, {"base_orientation": [1e9] * 4}, "of length 1"),
        (arm_parameters.jaw_of, HAPTIC, {"close_below": 0.3, "open_above": 0.3}, "less than"),
    ],
)
def test_values_that_do_not_fit_together_are_refused(
    made: Callable[[dict[str, Any]], Any],
    specs: tuple[Spec, ...],
    values: dict[str, Any],
    says: str,
) -> None:
    given = {spec.name: spec.default for spec in specs} | {"tools": ["grasper"]}
    made(given)
    with pytest.raises(ValueError, match=says):
        made(given | values)
