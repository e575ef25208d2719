"""Committed results say what the pages that show them say."""

from __future__ import annotations

import json
import statistics
from pathlib import Path

from tissue_sim import loop_study
from tissue_sim.loop_study import WITH, LoopRow, as_markdown


def test_the_study_of_the_loop_is_shown_as_it_came_out(repository: Path) -> None:
    result = json.loads((repository / "docs/results/loop.json").read_text(encoding="utf-8"))
    rows = [LoopRow(**row) for row in result["rows"]]
    assert len(rows) == 10
    assert loop_study._judge(rows) == {key: result[key] for key in loop_study._judge(rows)}
    assert as_markdown(result) in (repository / "docs/real_time.md").read_text(encoding="utf-8")
    # What was to be shown, and is.
    assert result["hz_median"] > 59.9
    assert result["late_share_median"] < 0.01
    assert result["pose_to_state_p99_median"] < 25.0
    assert statistics.median(ms for row in rows if row.variant == WITH for ms in row.apply_ms) < 2.0
