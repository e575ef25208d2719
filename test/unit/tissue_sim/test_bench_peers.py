"""The comparison with other simulators: the equilibrium, the clock, and what is not installed."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import skfem
from numpy.typing import NDArray
from rich.console import Console
from skfem.helpers import ddot, sym_grad, trace

from tissue_sim import bench_peers
from tissue_sim.peers import bullet_soft
from tissue_sim.peers.measure import REPEATS, TARGET, Entry, measure, pulled
from tissue_sim.peers.task import Task, task_of

PACKAGES = ("mujoco", "newton", "pybullet", "warp")


@pytest.fixture(scope="module")
def wall() -> Task:
    return task_of("wall")


class Scripted:
    """A simulator whose error is read from a list; the last one stays."""

    def __init__(self, task: Task, settings: dict[str, Any]) -> None:
        self._errors = [float(error) for error in settings["script"].split()]
        self._task, self._steps = task, -1

    def pull(self) -> None:
        self._steps = 0

    def step(self) -> None:
        self._steps += self._steps >= 0

    def displacement(self) -> NDArray[np.floating]:
        place = min(max(self._steps, 1), len(self._errors)) - 1
        return (1.0 + self._errors[place]) * self._task.exact


def settings_of(errors: list[float]) -> dict[str, Any]:
    return {"script": " ".join(map(str, errors))}


def scripted(*lists: list[float]) -> Entry:
    return Entry("scripted", tuple(map(settings_of, lists)), Scripted)


def test_the_exact_equilibrium_is_that_of_scikit_fem(wall: Task) -> None:
    task, (lam, mu) = wall, wall.lame

    @skfem.BilinearForm
    def elasticity(u, v, _):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
        strain, other = sym_grad(u), sym_grad(v)
        return lam * trace(strain) * trace(other) + 2.0 * mu * ddot(strain, other)

    mesh = skfem.MeshTet(task.points.T.copy(), task.tets.T.copy(), sort_t=False)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP1()))
    prescribed = np.zeros((len(task.points), 3))
    prescribed[task.held] = task.vector
    u = np.zeros(basis.N)
    u[basis.nodal_dofs] = prescribed.T
    blocked = basis.nodal_dofs[:, ~task.free].ravel()
    solution = skfem.solve(*skfem.condense(elasticity.assemble(basis), x=u, D=blocked))
    assert task.error(solution[basis.nodal_dofs].T) < 1e-9
    assert task.largest_error(solution[basis.nodal_dofs].T) < 1e-9


def test_masses_add_up_to_density_times_volume(wall: Task) -> None:
    assert wall.masses.sum() == pytest.approx(wall.material.density * 0.064 * 0.1 * 0.004)


def test_arrival_is_when_the_error_has_stayed_below_the_target(wall: Task) -> None:
    errors = [0.5, 0.9 * TARGET, 2 * TARGET, 0.5 * TARGET, 0.2 * TARGET]
    run = pulled(scripted(errors), wall, settings_of(errors), 10.0)
    assert run.end == "arrived"
    assert run.steps == 4
    assert run.error == pytest.approx(errors[-1])
    assert run.arrived_ms == pytest.approx(4 * run.step_ms)


@pytest.mark.parametrize(
    ("errors", "end"), [([0.5, 0.3], "at rest"), ([0.5, 2e3], "lost"), ([0.5, np.nan], "lost")]
)
def test_what_does_not_arrive_says_why(wall: Task, errors: list[float], end: str) -> None:
    run = pulled(scripted(errors), wall, settings_of(errors), 10.0)
    assert (run.end, run.arrived_ms) == (end, None)


def test_the_time_is_over_where_tissue_only_creeps(wall: Task) -> None:
    errors = np.linspace(0.9, 0.5, 100_000).tolist()
    run = pulled(scripted(errors), wall, settings_of(errors), 0.001)
    assert (run.end, run.arrived_ms) == ("time", None)


def test_the_best_settings_count(wall: Task) -> None:
    slow, fast = [0.5] * 400 + [0.01], [0.01]
    row = measure(scripted([0.3], slow, fast), wall, 10.0)
    assert row["settings"] == settings_of(fast)
    assert len(row["arrived_ms_of_runs"]) == REPEATS
    assert [run["end"] for run in row["tried"]] == ["at rest", "arrived", "arrived"]


def test_a_peer_that_is_not_installed_is_named_and_the_others_go_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, repository: Path
) -> None:
    for name in PACKAGES:
        monkeypatch.setitem(sys.modules, name, None)
    said: list[str] = []
    result = bench_peers.run_peers(
        tmp_path / "peers.json", 1.0, ("wall",), (scripted([0.01]), *bench_peers.PEERS), said.append
    )
    assert [row["simulator"] for row in result["rows"]] == ["scripted"]
    printed = io.StringIO()
    bench_peers.print_table(result, Console(file=printed, width=150))
    for entry in bench_peers.PEERS:
        line = f"not installed: {bench_peers.INSTALL}"
        assert f"{entry.label}: {line}" in printed.getvalue()
        assert f"{entry.label} {line}" in said
    assert (repository / bench_peers.LOCK).is_file()


def test_no_peer_is_imported_before_it_is_used() -> None:
    names = f"{{{', '.join(map(repr, PACKAGES))}}}"
    code = f"import sys, tissue_sim.bench_peers; sys.exit(len({names} & set(sys.modules)))"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_the_file_for_bullet_holds_the_mesh(wall: Task, tmp_path: Path) -> None:
    bullet_soft.write_vtk(tmp_path / "tissue.vtk", wall.points, wall.tets)
    mesh = meshio.read(tmp_path / "tissue.vtk")
    assert (mesh.points == wall.points).all()
    assert (mesh.cells_dict["tetra"] == wall.tets).all()


@pytest.mark.parametrize(
    ("entry", "settings"),
    [
        (bench_peers.PEERS[0], {"solver": "CG", "time_step": 0.1, "iterations": 100}),
        (bench_peers.PEERS[1], {"time_step": 1 / 60, "iterations": 10}),
        (bench_peers.PEERS[3], {"time_step": 1 / 240, "damping": 0.01}),
    ],
    ids=lambda value: value.label if isinstance(value, Entry) else "",
)
def test_a_peer_arrives(wall: Task, entry: Entry, settings: dict[str, Any]) -> None:
    pytest.importorskip(entry.package)
    run = pulled(entry, wall, settings, 60.0)
    assert run.end == "arrived"
    assert run.error < 0.02
