"""The space of a fit is a unit cube whose points are values that the subject can have."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from tissue_sim.compare.fit.space import FitParameter, Space, parse_range
from tissue_sim.compare.subject import parse_subject

LINEAR = FitParameter("step", 0.1, 1.9)
LOG = FitParameter("springs.stiffness", 1e-3, 1e3, log=True)
QUASI_STATIC = parse_subject("quasi_static")


@given(some.floats(0.0, 1.0), some.floats(0.0, 1.0))
def test_points_and_values_are_the_same_said_in_two_ways(first: float, second: float) -> None:
    space = Space((LINEAR, LOG))
    values = space.decode(np.array([first, second]))
    assert space.encode(values) == pytest.approx([first, second], abs=1e-12)
    assert space.decode(space.encode(values)) == pytest.approx(values, rel=1e-12)


def test_equal_differences_or_equal_ratios_are_equally_far_apart() -> None:
    assert LINEAR.value(0.5) == pytest.approx(1.0)
    assert LOG.value(0.5) == pytest.approx(1.0)
    assert LOG.value(0.75) / LOG.value(0.5) == pytest.approx(LOG.value(0.5) / LOG.value(0.25))


@pytest.mark.parametrize("parameter", [LINEAR, LOG])
@given(place=some.floats(-1e3, 1e3))
def test_no_point_is_out_of_bounds(parameter: FitParameter, place: float) -> None:
    assert parameter.low <= parameter.value(place) <= parameter.high
    assert (parameter.value(-0.1), parameter.value(1.1)) == (parameter.low, parameter.high)


@given(some.floats(0.0, 1.0))
def test_whole_numbers_are_marked_and_rounded(place: float) -> None:
    space = Space.parse("levels=1..8", "springs.per_element=0..1").checked(QUASI_STATIC)
    values = space.decode(np.array([place, place]))
    assert values["levels"] in range(1, 9)
    assert values["springs.per_element"] in (0, 1)
    QUASI_STATIC.with_values(values).checked()


def test_a_range_is_read_from_one_text() -> None:
    assert parse_range("step=0.1..1.9") == LINEAR
    assert parse_range(" springs.stiffness = 1e-3..1e3:log") == LOG
    assert parse_range("x=-2..-1") == FitParameter("x", -2.0, -1.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("step", "not understood"),
        ("step=1", "not understood"),
        ("=0..1", "not understood"),
        ("step=0.1..1.9:ln", "not understood"),
        ("step=low..high", "could not convert"),
        ("step=1.9..0.1", "lower one first"),
        ("step=1..1", "lower one first"),
        ("step=0.1..inf", "finite"),
        ("step=0..1:log", "bounds above 0"),
    ],
)
def test_a_range_that_is_none_is_refused_with_an_example(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says) as refusal:
        parse_range(text)
    assert "springs.stiffness=0.1..100:log" in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("stiffnes=1..2", "allowed: step, .*levels, .*material.young_modulus, .*springs.stiffness"),
        ("springs.lenght=1..2", "allowed: .*springs.connecting"),
        ("step=0.1..5", "bound 5 of step: .*allowed: 0.01 to 1.99"),
        ("levels=1.5..8", "bound 1.5 of levels: .*whole number"),
        ("springs.stiffness=-1..1", "bound -1 of springs.stiffness: .*out of range"),
        ("material.poisson_ratio=0.1..0.5", "bound 0.5 of material.poisson_ratio: .*out of range"),
    ],
)
def test_values_that_the_model_cannot_have_are_refused(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        Space.parse(text).checked(QUASI_STATIC)


def test_a_space_has_sides_and_each_of_them_once() -> None:
    with pytest.raises(ValueError, match="nothing to fit"):
        Space(())
    with pytest.raises(ValueError, match="step is there twice"):
        Space.parse("step=0.1..1", "step=0.2..1")


def test_values_that_are_missing_or_out_of_bounds_have_no_point() -> None:
    space = Space((LINEAR, LOG))
    with pytest.raises(ValueError, match=r"springs\.stiffness has no value"):
        space.encode({"step": 1.0})
    with pytest.raises(ValueError, match=r"step = 2 is out of bounds; allowed: 0.1 to 1.9"):
        space.encode({"step": 2.0, "springs.stiffness": 1.0})
    with pytest.raises(ValueError, match="out of bounds"):
        space.encode({"step": math.nan, "springs.stiffness": 1.0})
