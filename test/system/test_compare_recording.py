"""A session that several processes played and recorded is an interaction to compare under."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from support.processes import Processes, processes
from support.recorded_lift import COLUMNS, ROWS, STEPS, record
from tissue_sim.compare.comparison import compare
from tissue_sim.compare.effort import Effort
from tissue_sim.compare.organs import load_organ
from tissue_sim.compare.sources.choose import interaction_from
from tissue_sim.compare.subject import Subject


@pytest.fixture
def world(ros_domain: int, tmp_path: Path) -> Iterator[Processes]:
    with processes(tmp_path) as made:
        yield made


def test_a_recorded_session_is_what_its_own_model_does(world: Processes, repository: Path) -> None:
    """Its model with its steps leaves nothing over where every frame is recorded; others do."""
    bag = record(world, repository)
    organ = load_organ("wall", parameters={"columns": COLUMNS, "rows": ROWS})
    found = interaction_from(str(bag), organ, rate_hz=60.0)
    assert found.notes == ()
    held = found.interaction.held.any(axis=1)
    assert held.sum() / 60 == pytest.approx(1.2, abs=0.1)
    assert found.interaction.amplitude == pytest.approx(8.94e-3, rel=1e-2)
    own = Subject("quasi_static", effort=Effort(steps=STEPS))
    other = Subject("quasi_static", effort=Effort(steps=1), label="half as fast")
    result = compare(organ, found.interaction, found.reference(), [own, other])
    assert result.targets[0].difference.largest < 1e-7
    assert result.targets[1].relative > 0.01
