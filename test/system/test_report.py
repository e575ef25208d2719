"""The report of a session that several processes played and recorded."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.processes import Processes, processes
from support.recorded_lift import record
from support.tissue_command import tissue


@pytest.fixture
def world(ros_domain: int, tmp_path: Path) -> Iterator[Processes]:
    with processes(tmp_path) as made:
        yield made


def test_figures_are_those_of_the_procedure(
    world: Processes,
    repository: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It lifts by (0, 4, 8) mm, pressed once, and cuts nothing; how fast is the machine's."""
    monkeypatch.setattr(sys, "argv", sys.argv)
    bag, out = record(world, repository), world.folder / "report"
    code, _, errors = tissue(capsys, "report", str(bag), "--no-pictures", "--out", str(out))
    assert (code, errors) == (0, "")
    (session,) = json.loads((out / "result.json").read_text())["sessions"]
    value = {key: figure["value"] for key, figure in session["figures"].items()}
    assert value["tool.grasper.path"] == pytest.approx(math.hypot(4e-3, 8e-3), rel=1e-3)
    assert value["tool.grasper.presses"] == 1.0
    # Known, whatever they are on a machine that stalls: forces recorded, stress read again.
    assert value["tool.grasper.peak_force"] is not None
    assert value["tissue.peak"] is not None
    assert value["cuts.count"] == 0.0
    assert session["figures"]["cuts.length"]["why"] == "nothing was cut"
    assert session["organ"]["name"] == "wall"
