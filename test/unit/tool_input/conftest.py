"""Fixtures of the tests of tool_input."""

from __future__ import annotations

import pytest


@pytest.fixture
def anywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Presses do not wait for the tool: no simulation is there to say where it is."""
    monkeypatch.setattr("tool_input.table.person.ARRIVAL_PATIENCE", -1.0)
