"""The committed figures of the repair of a septal defect say what its page says."""

from __future__ import annotations

import json
import re
from pathlib import Path

from tissue_sim import repair_study
from tissue_sim.scene_file import config_folder
from tool_input.procedure import load_procedure
from viz_bridge.repair_pictures import WANTED


def test_the_repair_is_shown_as_it_came_out(repository: Path) -> None:
    file = repository / "docs/results/asd_repair.json"
    result = json.loads(file.read_text(encoding="utf-8"))
    page = (repository / "docs/asd_repair.md").read_text(encoding="utf-8")
    assert repair_study.as_markdown(result) in page
    rows = {row["model"]: row for row in result["rows"]}
    assert tuple(rows) == repair_study.MODELS
    # What was to be shown, and is: it passes with every model.
    for row in rows.values():
        assert repair_study.problems(row) == []
    for picture in WANTED:
        assert (repository / f"docs/pictures/{picture.name}.png").is_file()
        assert f"pictures/{picture.name}.png" in page
    # The procedure is still the one that was played.
    procedure = load_procedure(config_folder() / "procedures" / repair_study.PROCEDURE)
    asked = [
        (event.time, event.action)
        for event in procedure.events
        if event.action not in ("label", "press", "release")
    ]
    for row in rows.values():
        steps = sorted((step["time"], step["action"]) for step in row["steps"])
        assert steps == sorted(asked)


def test_the_times_on_the_page_are_those_of_the_procedure(repository: Path) -> None:
    page = (repository / "docs/asd_repair.md").read_text(encoding="utf-8")
    table = page.split("## What happens")[1].split("\n## ")[0]
    shown = {float(time) for time in re.findall(r"^\| (\d+(?:\.\d+)?) \|", table, re.MULTILINE)}
    procedure = load_procedure(config_folder() / "procedures" / repair_study.PROCEDURE)
    asked = {event.time for event in procedure.events if event.action != "label"}
    moved = {motion.start for motions in procedure.motions.values() for motion in motions}
    assert asked <= shown <= asked | moved
    assert f"asd_repair.yaml), {procedure.end:g} s:" in table
