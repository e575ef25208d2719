from __future__ import annotations

import numpy as np
import pytest

from cut_service.cut_parameters import SPECS, CutParameters
from cut_service.ledger import Ledger
from cut_service.planner import Settings
from cut_service.waiting import Until


def test_a_repeat_finds_the_first_request_also_while_it_is_worked_on() -> None:
    ledger: Ledger[str] = Ledger(4)
    entry, is_new = ledger.open("a")
    assert is_new
    again, is_new = ledger.open("a")
    assert again is entry
    assert not is_new
    entry.answer = "done"
    assert ledger.open("a")[0].answer == "done"


def test_memory_is_bounded_and_never_forgets_what_is_worked_on() -> None:
    ledger: Ledger[str] = Ledger(4)
    working, _ = ledger.open("long")
    for k in range(100):
        ledger.open(str(k))[0].answer = "done"
        assert len(ledger) <= 5
    assert ledger.open("long")[0] is working
    assert ledger.open("0")[1]
    assert not ledger.open("99")[1]


def test_waiting_yields_until_it_holds_or_time_is_up() -> None:
    answers = iter([False, False, True])
    steps = Until(lambda: next(answers), 10.0).__await__()
    assert [next(steps), next(steps)] == [None, None]
    with pytest.raises(StopIteration) as end:
        next(steps)
    assert end.value.value is True

    steps = Until(lambda: False, -1.0).__await__()
    with pytest.raises(StopIteration) as end:
        next(steps)
    assert end.value.value is False


def test_the_parameters_defaults_are_those_of_the_planner() -> None:
    made = CutParameters.of({spec.name: spec.default for spec in SPECS})
    assert made.method == "split"
    assert made.settings.crease_angle == pytest.approx(Settings().crease_angle, abs=0.01)
    for name in (
        "snap", "quality_floor", "volume_budget", "smallest_piece", "vertex_share", "vertex_reach",
        "remove_degeneracies", "wanted_ratio", "wanted_length",
    ):  # fmt: skip
        assert getattr(made.settings, name) == getattr(Settings(), name)
    assert np.degrees(made.settings.crease_angle) == pytest.approx(40.0)
    for spec in SPECS:
        assert spec.checked(spec.default) == spec.default
        assert spec.description
