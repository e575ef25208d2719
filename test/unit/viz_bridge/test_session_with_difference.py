"""`tissue run --difference`: the second model's node takes part from the first frame on."""

from __future__ import annotations

from pathlib import Path

import pytest

from tissue_sim.runner import RunOptions, plan_run
from tissue_sim.session import process_specs, with_waiting


def options(out: Path, **more: object) -> RunOptions:
    given: dict[str, object] = {
        "scene": "wall", "units": "", "fixed": "", "model": "", "kind": "", "headless": False,
        "frames": 10, "seconds": 0.0, "procedure": None, "out": out, "bag": True,
        "recording": False, "viewer": False, "record_state_hz": 10.0,
    }  # fmt: skip
    return RunOptions(**{**given, **more})  # type: ignore[arg-type]


def waits(out: Path, difference: str) -> dict[str, int]:
    plan, _ = plan_run(options(out, difference=difference))
    entries = with_waiting(plan).simulation["wait_for"]
    return {topic: int(count) for topic, count in (entry.rsplit(":", 1) for entry in entries)}


def test_the_clock_waits_for_the_second_model_and_what_draws_it(tmp_path: Path) -> None:
    without, beside = waits(tmp_path, ""), waits(tmp_path, "lr@4")
    # The node itself, and the recording for rerun that nobody asked for by name.
    assert all(beside[topic] == count + 2 for topic, count in without.items())
    assert set(beside) == {"tissue/journal", "tissue/state", "tissue/edits"}


def test_its_process_gets_the_model_as_it_was_written(tmp_path: Path) -> None:
    text = "exact=finite_element:tolerance=1e-06@rest"
    plan, _ = plan_run(options(tmp_path, difference=text))
    specs = process_specs(plan)
    assert f"model:={text}" in specs["difference"].command
    assert "rerun" in specs
    assert "difference" not in process_specs(plan_run(options(tmp_path))[0])


@pytest.mark.parametrize("text", ["jelly", "lr@never", "lr:springs.stiffness=2"])
def test_a_model_that_cannot_follow_is_refused_before_anything_starts(
    text: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match="allowed"):
        plan_run(options(tmp_path / "not made", difference=text))
    assert not (tmp_path / "not made").exists()
