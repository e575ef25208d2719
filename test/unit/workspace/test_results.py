"""Committed results say what the pages that show them say."""

from __future__ import annotations

import json
import statistics
from pathlib import Path
from typing import Any

import pytest

from cut_service import cut_study, property_study, random_edits, session_study, size_study, trial
from cut_service.planner import METHODS
from tissue_sim import (
    acceleration_study,
    bench,
    bench_growth,
    bench_peers,
    bench_table,
    cut_loop_study,
    grab_study,
    loop_study,
    model_study,
    prediction_study,
    progressive_study,
    release_study,
)
from tissue_sim.compare.fit import fit_study_table, pool_study
from tissue_sim.elastic import registry
from tissue_sim.loop_study import WITH, LoopRow, as_markdown
from tissue_sim.peers.measure import pulled
from tissue_sim.peers.task import task_of
from tissue_sim.release_study import MODELS, RADII


def test_the_study_of_the_loop_is_shown_as_it_came_out(repository: Path) -> None:
    result = json.loads((repository / "docs/results/loop.json").read_text(encoding="utf-8"))
    rows = [LoopRow(**row) for row in result["rows"]]
    assert len(rows) == 10
    assert loop_study.judge(rows) == {key: result[key] for key in loop_study.judge(rows)}
    assert as_markdown(result) in (repository / "docs/real_time.md").read_text(encoding="utf-8")
    # What was to be shown, and is.
    assert result["hz_median"] > 59.9
    assert result["late_share_median"] < 0.01
    assert result["pose_to_state_p99_median"] < 25.0
    assert statistics.median(ms for row in rows if row.variant == WITH for ms in row.apply_ms) < 2.0


def test_the_study_of_many_cuts_in_the_loop_is_shown_as_it_came_out(repository: Path) -> None:
    result = json.loads((repository / "docs/results/cut_loop.json").read_text(encoding="utf-8"))
    rows = [LoopRow(**row) for row in result["rows"]]
    again = cut_loop_study.judged(rows)
    assert {key: result[key] for key in again} == again
    page = (repository / "docs/real_time.md").read_text(encoding="utf-8")
    assert cut_loop_study.as_markdown(result) in page
    cuts = [len(row.apply_ms) for row in rows if row.variant == WITH]
    assert cuts == [13] * (len(rows) // 2)
    # What was to be shown, and is.
    assert result["apply_ms"]["median"] < 2.0
    assert result["late_difference_median"] < 0.01 * min(row.frames for row in rows)


def test_the_study_of_progressive_cuts_is_shown_as_it_came_out(repository: Path) -> None:
    result = json.loads((repository / "docs/results/progressive.json").read_text(encoding="utf-8"))
    page = (repository / "docs/progressive_cutting.md").read_text(encoding="utf-8")
    assert progressive_study.as_markdown(result) in page
    assert set(result["cases"]) == set(progressive_study.CASES)
    for name, case in result["cases"].items():
        rows = [LoopRow(**row) for row in case["rows"]]
        again = progressive_study.judged(rows, case["strokes"])
        assert {key: case[key] for key in again} == again
        assert all(stroke["failed"] == stroke["missing"] == 0 for stroke in case["strokes"])
        torn = [kinds.get("tear", 0) for kinds in case["edits"]]
        assert (min(torn) > 0) == progressive_study.CASES[name].tears


def test_the_study_of_releases_is_shown_as_it_came_out(repository: Path) -> None:
    file = repository / "docs/results/seeded_release.json"
    result = json.loads(file.read_text(encoding="utf-8"))
    page = (repository / "docs/seeded_release.md").read_text(encoding="utf-8")
    assert release_study.as_markdown(result) in page
    rows = {
        (row["geometry"], row["model"], row["radius"]): release_study.ReleaseRow(**row)
        for row in result["rows"]
    }
    wanted = {(g, m, r) for g, of in MODELS.items() for m in of for r in RADII}
    assert set(rows) == wanted
    # What was to be shown, and is: iterating models return from far in a fraction of the steps.
    for model in ("lr", "vertex_block_descent"):
        plain, seeded = (rows["heart", model, radius].steps[0] for radius in (0.0, 0.04))
        assert plain is not None
        assert seeded is not None
        assert seeded < 0.2 * plain
    # Spot check: steps depend on nothing but the code.
    again = release_study.released("wall", "lr", 0.04, 300)
    for now, then in zip(again.steps, rows["wall", "lr", 0.04].steps, strict=True):
        assert now is not None
        assert then is not None
        assert abs(now - then) <= 0.1 * then
    assert again.seeded == rows["wall", "lr", 0.04].seeded


def test_the_bench_is_shown_as_it_came_out(repository: Path) -> None:
    page = (repository / "docs/benchmarks.md").read_text(encoding="utf-8")
    steps = json.loads((repository / "docs/results/bench.json").read_text(encoding="utf-8"))
    growth = json.loads((repository / "docs/results/growth.json").read_text(encoding="utf-8"))
    assert bench.as_markdown(steps) in page
    assert bench_table.in_short(steps) in (repository / "README.md").read_text(encoding="utf-8")
    assert bench_growth.as_markdown(growth) in page
    # The last digit is the processor's.
    assert bench_growth.slopes(growth["rows"]) == pytest.approx(growth["slopes"], rel=1e-12)
    assert [(row["model"], row["geometry"]) for row in steps["rows"]] == [
        (case.label, case.geometry) for case in bench.CASES
    ]


def test_the_time_of_a_step_grows_as_the_organ_does(repository: Path) -> None:
    growth = json.loads((repository / "docs/results/growth.json").read_text(encoding="utf-8"))
    assert set(growth["slopes"]) == {case.label for case in bench_growth.CASES_OF_GROWTH}
    assert all(0.9 <= slope <= 1.15 for slope in growth["slopes"].values())
    nodes = {row["nodes"] for row in growth["rows"]}
    assert min(nodes) == 1000
    assert max(nodes) > 350_000


def test_the_models_pulled_the_same_way_are_shown_as_they_came_out(repository: Path) -> None:
    result = json.loads((repository / "docs/results/models.json").read_text(encoding="utf-8"))
    rows = [model_study.Row(**row) for row in result["rows"]]
    wanted = [(g, v.label) for g in ("wall", "heart") for v in model_study.VARIANTS]
    assert [(row.geometry, row.label) for row in rows] == wanted
    page = (repository / "docs/models.md").read_text(encoding="utf-8")
    for geometry in ("wall", "heart"):
        assert model_study.as_markdown(rows, geometry) in page
        assert (repository / f"docs/pictures/models_{geometry}.png").is_file()
    assert {row.model for row in rows} == set(registry.names())
    for name in registry.names():
        assert (repository / f"docs/pictures/model_{name}.png").is_file()
    # What every solid has in common, and is: no element inside out.
    for row in rows:
        if row.model in ("finite_element", "vertex_block_descent"):
            assert row.inverted == 0
    # Spot check: shapes depend on nothing but the code.
    variants = tuple(
        v for v in model_study.VARIANTS if v.label in ("finite_element", "lr", "chain_mail")
    )
    shown = {row.label: row for row in rows if row.geometry == "wall"}
    for shape in model_study.study(("wall",), variants):
        then = shown[shape.row.label]
        assert abs(shape.row.mean_difference_mm - then.mean_difference_mm) < 0.02
        assert abs(shape.row.largest_difference_mm - then.largest_difference_mm) < 0.1
        assert shape.row.inverted == then.inverted


def test_the_comparison_with_peers_is_shown_as_it_came_out(repository: Path) -> None:
    result = json.loads((repository / "docs/results/peers.json").read_text(encoding="utf-8"))
    page = (repository / "docs/peers.md").read_text(encoding="utf-8")
    assert bench_peers.as_markdown(result) in page
    entries = {entry.label: entry for entry in bench_peers.OWN + bench_peers.PEERS}
    rows = {(row["geometry"], row["simulator"]): row for row in result["rows"]}
    assert set(rows) == {(g, label) for g in bench_peers.GEOMETRIES for label in entries}
    for package, about in result["packages"].items():
        assert f"{package} {about['version']} ({about['licence']})" in page
    # What the page says, and is.
    for geometry in bench_peers.GEOMETRIES:
        arrived = {
            label: row["arrived_ms"]
            for (where, label), row in rows.items()
            if where == geometry and row["arrived_ms"] is not None
        }
        assert {"MuJoCo flex", "PyBullet", "vertex_block_descent"} <= set(arrived)
        assert not {"newton XPBD", "quasi_static", "spring_mass", "lr"} & set(arrived)
        first = sorted(arrived, key=lambda label: arrived[label])[:2]
        assert first == ["finite_element, motion known", "finite_element"]
    # Spot check: steps depend on nothing but the code.
    for label in ("finite_element", "vertex_block_descent"):
        row = rows["wall", label]
        run = pulled(entries[label], task_of("wall"), row["settings"], 60.0)
        assert abs(run.steps - row["steps"]) <= 0.1 * row["steps"]


def test_accelerations_and_predictors_are_shown_as_they_came_out(repository: Path) -> None:
    file = repository / "docs/results/acceleration.json"
    result = json.loads(file.read_text(encoding="utf-8"))
    page = (repository / "docs/acceleration.md").read_text(encoding="utf-8")
    assert acceleration_study.as_markdown(result) in page
    assert prediction_study.frames_as_markdown(result) in page
    assert prediction_study.responses_as_markdown(result) in page
    assert (repository / "docs/pictures/acceleration.png").is_file()
    sweeps = {
        (row["geometry"], row["model"], json.dumps(row["parameters"])): row["errors"]
        for row in result["sweeps"]
    }
    assert set(sweeps) == {
        (g, m, json.dumps(v))
        for g in acceleration_study.GEOMETRIES
        for m in acceleration_study.MODELS
        for v in acceleration_study.VARIANTS
    }
    # What the page says, and is: momentum before Chebyshev's method before neither.
    for geometry, best in (("wall", 0.95), ("heart", 0.97)):
        for model in acceleration_study.MODELS:
            last = {
                key[2]: errors[-1] for key, errors in sweeps.items() if key[:2] == (geometry, model)
            }
            momentum = last.pop(json.dumps({"momentum": best}))
            chebyshev = min(value for key, value in last.items() if "chebyshev" in key)
            assert 10 * momentum < chebyshev < last["{}"]
    frames = {
        (row["geometry"], row["model"], row["steps"], row["predictor"], row["predictor_steps"]): row
        for row in result["frames"]
    }
    for steps in prediction_study.STEPS["heart"]:
        case = ("heart", "vertex_block_descent", steps)
        assert frames[*case, "finite_element", 1]["moving"] < 0.15 * frames[*case, "", 0]["moving"]
    # Spot checks: errors depend on nothing but the code.
    organ = acceleration_study.Organ.of("wall")
    for parameters in ({"momentum": 0.95}, {"chebyshev": 0.95}):
        again = acceleration_study.accelerated(organ, "quasi_static", parameters, sweeps=30)
        then = sweeps["wall", "quasi_static", json.dumps(parameters)][29]
        assert abs(again.errors[-1] - then) < 0.03 * then
    now = prediction_study.pulled(organ, "vertex_block_descent", 2, "finite_element", 1)
    moving = frames["wall", "vertex_block_descent", 2, "finite_element", 1]["moving"]
    assert abs(now.moving - moving) < 0.1 * moving


def test_the_study_of_grabs_is_shown_as_it_came_out(repository: Path) -> None:
    result = json.loads((repository / "docs/results/grabs.json").read_text(encoding="utf-8"))
    page = (repository / "docs/finite_element.md").read_text(encoding="utf-8")
    assert grab_study.as_markdown(result) in page
    rows = {(r["geometry"], r["motion"], r["event"]): r for r in result["rows"]}
    assert len(rows) == len(grab_study.GEOMETRIES) * len(grab_study.MOTIONS) * 5
    for (geometry, motion, event), row in rows.items():
        # What was to be shown, and is: exact on the wall from the first frame on.
        if geometry == "wall":
            assert row["exact_after"] <= 0.02
        if row["known_ms"] is not None:
            assert row["known_ms"] < 1.0
        if row["error"] is not None:
            assert row["error"] < 0.01
        if geometry == "heart" and motion == "moves" and event == "first grab":
            assert row["exact_after"] < 1.0
            assert row["error"] is not None


def test_the_ways_of_cutting_are_shown_as_they_came_out(repository: Path) -> None:
    result = json.loads((repository / "docs/results/cuts.json").read_text(encoding="utf-8"))
    page = (repository / "docs/cutting.md").read_text(encoding="utf-8")
    assert cut_study.as_markdown(result) in page
    rows = {row["label"]: cut_study.CutRow(**row) for row in result["rows"]}
    assert list(rows) == ["not cut", *cut_study.VARIANTS]
    split, divided, removed = (rows[method] for method in METHODS)
    whole = rows["not cut"]
    # What the page says, and is: dividing is closest to the sweep, splitting keeps the elements.
    assert divided.distance_mean < split.distance_mean < removed.distance_mean
    assert split.distance_mean < 0.5 * rows["split, not snapped"].distance_mean
    # Removing degeneracies costs little of that and keeps elements and stable steps as they were.
    left = rows["split, degeneracies left"]
    assert left.quality >= 0.0999
    assert split.quality >= 0.95 * whole.quality
    assert split.step_us > 0.9 * whole.step_us > 2.0 * left.step_us
    assert split.distance_mean < 1.5 * left.distance_mean
    assert split.covered > left.covered - 0.01
    assert split.degenerate_left < 0.05 * split.degenerate
    assert split.iterations <= 1.1 * left.iterations
    assert divided.poor < 0.5 * rows["subdivide, degeneracies left"].poor
    assert divided.distance_mean < 2.0 * rows["subdivide, degeneracies left"].distance_mean
    assert rows["split, not snapped"].quality == whole.quality <= removed.quality
    assert split.elements == whole.elements < divided.elements
    assert abs(split.volume) < 1e-3 * result["cuts"]
    assert abs(divided.volume) < 1e-9 * result["cuts"]
    assert abs(rows["split, not snapped"].volume) < 1e-12
    # Spot check: figures depend on nothing but the code.
    then, now = cut_study.CutRow(**result["spot"]), cut_study.spot()
    for name in ("cuts", "missed", "faces", "nodes", "elements"):
        assert getattr(now, name) == getattr(then, name)
    for name in ("distance_mean", "covered", "quality"):
        assert abs(getattr(now, name) - getattr(then, name)) < 1e-6


def test_what_a_cut_costs_is_shown_as_it_came_out(repository: Path) -> None:
    result = json.loads((repository / "docs/results/cut_sizes.json").read_text(encoding="utf-8"))
    page = (repository / "docs/cutting.md").read_text(encoding="utf-8")
    assert size_study.as_markdown(result) in page
    rows = {(r["organ"], r["method"]): size_study.SizeRow(**r) for r in result["rows"]}
    assert {organ for organ, _ in rows} == set(size_study.ORGANS)
    small, _, large, _ = size_study.ORGANS
    for method in METHODS:
        few, many = rows[small, method], rows[large, method]
        assert many.nodes > 30 * few.nodes
        assert few.faces > 50
        # What the page says, and is: forty times the nodes, and far from forty times the cost.
        assert many.both_ms < 6.0 * few.both_ms
        assert many.apply_ms < 2.0 * few.apply_ms
    heart = rows[list(size_study.ORGANS)[-1], "split"]
    assert heart.both_ms < 50.0
    assert heart.apply_ms < 2.0


def test_random_cuts_and_undos_had_no_fault(repository: Path) -> None:
    path = repository / "docs/results/cut_properties.json"
    result = json.loads(path.read_text(encoding="utf-8"))
    page = (repository / "docs/cutting.md").read_text(encoding="utf-8")
    assert property_study.as_markdown(result) in page
    assert session_study.as_markdown(result["sessions"]) in page
    tallies = [property_study.Tally(**row) for row in result["rows"]]
    assert {(t.organ, t.way) for t in tallies} == {
        (organ, way) for organ in property_study.ORGANS for way in random_edits.WAYS
    }
    assert sum(t.cuts for t in tallies) > 3000
    assert sum(t.cuts for t in tallies if t.organ == "heart") > 200
    assert sum(t.undone for t in tallies) > 3000
    for tally in tallies:
        assert tally.faults == []
        assert tally.parted_in_two == tally.parted
        assert tally.cuts > 0
        if tally.way == "split":
            assert tally.volume < trial.VOLUME_SNAPPED
        elif tally.way != "remove":
            assert tally.volume < trial.VOLUME_KEPT
    # Spot check: figures depend on nothing but the code and the kind of processor.
    then = [property_study.Tally(**row) for row in result["spot"]]
    same = bench.target() == result["target"]
    for wanted, tally in zip(then, property_study.spot(result["seed"]), strict=True):
        assert tally.faults == []
        for name in ("organ", "way", "runs", "cuts", "missed", "undone", "redone", "most_parts"):
            if same or name in ("organ", "way", "runs"):
                assert getattr(tally, name) == getattr(wanted, name)
        assert abs(tally.ratio - wanted.ratio) < 1e-6 or not same
    _sessions_had_no_fault(result, same)


def _sessions_had_no_fault(result: dict[str, Any], same_processor: bool) -> None:
    """Cuts, tears, burns, patches, stitches and undos in random order."""
    tallies = {row["organ"]: session_study.SessionTally(**row) for row in result["sessions"]}
    assert list(tallies) == list(session_study.ORGANS)
    assert sum(sum(t.done.values()) for t in tallies.values()) > 10_000
    assert sum(tallies["heart"].done.values()) > 1000
    for organ, tally in tallies.items():
        assert tally.faults == []
        assert tally.parted_in_two == tally.parted
        assert tally.volume < trial.VOLUME_SNAPPED
        what = {"cut: split", "tear", "patch", "sew", "tighten", "unsew", "undo", "redo"}
        solid = {"cut: subdivide", "cut: remove", "burn"}
        assert what | (set() if "surfaces" in organ else solid) <= set(tally.done)
    then = [session_study.SessionTally(**row) for row in result["spot_sessions"]]
    for wanted in then:
        now = property_study.spot_session(wanted.organ, result["seed"])
        assert now.faults == []
        assert now.sessions == wanted.sessions
        if same_processor:
            for name in ("done", "missed", "most_parts", "deepest"):
                assert getattr(now, name) == getattr(wanted, name)
            assert abs(now.ratio - wanted.ratio) < 1e-6


def test_fits_find_what_they_should_and_pools_gain(repository: Path) -> None:
    fits = json.loads((repository / "docs/results/fit.json").read_text(encoding="utf-8"))
    page = (repository / "docs/fit.md").read_text(encoding="utf-8")
    assert fit_study_table.as_markdown(fits) in page
    pools = json.loads((repository / "docs/results/pool.json").read_text(encoding="utf-8"))
    assert pool_study.as_markdown(pools) in (repository / "docs/scale.md").read_text("utf-8")
    assert all(row["same"] for row in pools["rows"])
    speed_up = {(row["way"], row["workers"]): row["speed_up"] for row in pools["rows"]}
    assert speed_up["pool", 2] > 1.5
