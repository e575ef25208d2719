"""The repair of an atrial septal defect on a coarse heart, by all processes, and looked at."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from tissue_sim.demo import operate
from tissue_sim.repair_study import PROCEDURE, problems, requests_of, tissue_figures
from tissue_sim.scene_file import config_folder, find_scene
from tissue_sim.session import SessionPlan
from viz_bridge.repair_pictures import WANTED, arrays_from

COARSE = {"shape.cell": 0.002, "steps_per_frame": 3, "model": "lr"}
FASTER = 0.75
"""Length of the procedure as a share of what it is."""


def _shortened(folder: Path) -> Path:
    content = yaml.safe_load((config_folder() / "procedures" / PROCEDURE).read_text())

    def shorter(item: Any) -> Any:
        if isinstance(item, list):
            return [shorter(entry) for entry in item]
        if not isinstance(item, dict):
            return item
        return {
            key: FASTER * value
            if key in ("at", "for", "end") and isinstance(value, int | float)
            else shorter(value)
            for key, value in item.items()
        }

    path = folder / "procedure.yaml"
    path.write_text(yaml.safe_dump(shorter(content), sort_keys=False))
    return path


def test_a_septal_defect_is_patched_and_all_of_it_is_valid_replayed_and_undone(
    ros_domain: int, tmp_path: Path
) -> None:
    assert ros_domain
    procedure = _shortened(tmp_path)
    plan = SessionPlan(
        scene=find_scene("heart").with_simulation(COARSE),
        out=tmp_path,
        procedure=procedure,
        clock="simulation",
        recording=False,
        monitor=False,
    )
    operate(plan, quiet=True)
    row = {
        "steps": requests_of(plan.script_file),
        **tissue_figures(plan.bag_folder, procedure),
    }
    assert problems(row) == []
    assert len(row["steps"]) == 10
    # The patch is a part of its own, however the organ is cut.
    assert [edit["parts"] for edit in row["edits"]] == [1, 2, 2, 2, 2, 2]
    assert row["patch_nodes"] > 100
    pictures = arrays_from(plan.bag_folder)
    assert list(pictures) == [wanted.name for wanted in WANTED]
    assert [len(arrays["threads"]) > 0 for arrays in pictures.values()] == 3 * [False] + 3 * [True]
