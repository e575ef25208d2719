"""The committed figures of the thesis' experiment say what its page says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tissue_sim.compare.thesis import influences, table
from tissue_sim.compare.thesis.conditions import Conditions
from tissue_sim.compare.thesis.experiment import FULL, SEED, SHORT, rows_of


@pytest.fixture
def page(repository: Path) -> str:
    return (repository / "docs/thesis.md").read_text(encoding="utf-8")


def read(repository: Path, name: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(
        (repository / f"docs/results/{name}.json").read_text(encoding="utf-8")
    )
    return content


def test_the_experiment_is_shown_as_it_came_out(repository: Path, page: str) -> None:
    result = read(repository, "thesis")
    assert rows_of(result["trials"]) == result["rows"]
    for shown in (
        table.as_markdown, table.parameters_as_markdown, table.thesis_values_as_markdown
    ):  # fmt: skip
        assert shown(result) in page
    assert result["conditions"] == json.loads(json.dumps(Conditions().to_json()))
    assert result["search"] == {
        "algorithm": "evolutionary", "seed": SEED, "population": FULL.population,
        "generations": list(FULL.generations),
    }  # fmt: skip
    assert "pictures/thesis.png" in page
    assert (repository / "docs/pictures/thesis.png").is_file()


def test_influences_are_shown_as_they_came_out(repository: Path, page: str) -> None:
    result = read(repository, "thesis_influences")
    assert influences.as_markdown(result) in page
    names = [entry["name"] for entry in result["influences"]]
    assert names == list(influences.INFLUENCES)
    assert result["search"]["generations"] == list(SHORT.generations)


def test_the_thesis_values_are_stable_where_the_page_says_so(repository: Path) -> None:
    """Sweeps with springs repeated for each element, Verlet's method with one for each edge."""
    rows = {row["row"]: row for row in read(repository, "thesis")["rows"]}
    lost = {
        (name, entry["per_element"]): entry["lost"] == entry["trials"]
        for name, row in rows.items()
        for entry in row["with_thesis_values"]
    }
    assert not lost["quasi-static, tetrahedra", 1.0]
    assert lost["dynamic, tetrahedra", 1.0]
    assert not lost["dynamic, tetrahedra", 0.0]
