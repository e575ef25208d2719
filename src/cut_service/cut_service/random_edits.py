"""Random cuts, tears, burns, patches and stitches of an organ, and undos and redos of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cut_service.burning import BurnSettings, Touch, peak_density, plan_burn
from cut_service.errors import CutCode, CutError
from cut_service.patching import PatchCode, PatchError, Wanted, plan_patch
from cut_service.planner import Settings, plan
from cut_service.rim import plan_rim
from cut_service.sheet_tearing import SheetTearSettings, plan_sheet_tear
from cut_service.suturing import (
    FARTHEST_REACH,
    Sewing,
    SutureCode,
    SutureError,
    plan_removal,
    plan_sewing,
    plan_tightening,
)
from cut_service.sweep import Sweep
from cut_service.tearing import TearSettings, plan_tear
from cut_service.trial import VOLUME_KEPT, VOLUME_SNAPPED, Reals, Trial
from cut_service.unswept import work_without_sweep
from tissue_sim.elastic.material_field import MaterialField
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.stress import element_material

SOFT = Material(young_modulus=5e4, poisson_ratio=0.3)
SHARES = (0.03, 0.1, 0.3, 3.0)
"""Half widths of sweeps as shares of the organ: from scratches to right through."""

WAYS: dict[str, tuple[str, Settings]] = {
    "split": ("split", Settings()),
    "split, not snapped": ("split", Settings(snap=False)),
    "subdivide": ("subdivide", Settings()),
    "remove": ("remove", Settings()),
}


def wave(points: Reals, random: np.random.Generator) -> Reals:
    """Displacements of a smooth deformation [m]: a wave along a random direction."""
    size = np.ptp(points, axis=0).max()
    along, way = random.normal(size=(2, 3))
    along, way = along / np.linalg.norm(along), way / np.linalg.norm(way)
    phase = 4.0 * (points - points.mean(axis=0)) @ along / size + random.uniform(0, 6)
    return np.asarray(0.04 * size * np.sin(phase)[:, None] * way)


def deform(trial: Trial) -> None:
    """Let go of the organ, bend it, or pull all of it one way; edits are planned on that shape."""
    random, rest = trial.random, trial.mesh.rest[: trial.mesh.node_rows]
    kind = random.integers(3)
    if kind == 0:
        trial.displace(np.zeros_like(rest))
    elif kind == 1:
        trial.displace(wave(rest, random))
    else:
        _stretch(trial)


def _stretch(trial: Trial) -> None:
    rest = trial.mesh.rest[: trial.mesh.node_rows]
    trial.displace(rest @ trial.random.uniform(-0.25, 0.25, (3, 3)))


def square(trial: Trial, half: float) -> Sweep:
    """A flat square of random direction about a node, half its side given [m]."""
    centre = trial.places[trial.random.choice(trial.living)]
    u, v = half * np.linalg.qr(trial.random.normal(size=(3, 3)))[0][:2]
    corners = [centre - u - v, centre + u - v, centre + u + v, centre - u + v]
    return Sweep.from_arrays(corners, [[0, 1, 2], [0, 2, 3]])


def wavy(trial: Trial, half: float) -> Sweep:
    """A strip between two crooked lines about a node; it may cross itself."""
    random = trial.random
    centre = trial.places[random.choice(trial.living)]
    along, across, out = half * np.linalg.qr(random.normal(size=(3, 3)))[0]
    steps = np.linspace(-1.0, 1.0, int(random.integers(3, 9)))[:, None]
    crooked = random.uniform(-0.5, 0.5, (len(steps), 1)) * out
    line = centre + steps * along + crooked
    return Sweep.between(line - across, line + across + 0.3 * random.normal() * out)


def through_nodes(trial: Trial, half: float) -> Sweep:
    """A triangle with its corners at three nodes: everything lies exactly on something."""
    places, random = trial.places, trial.random
    first = random.choice(trial.living)
    distance = np.linalg.norm(places[trial.living] - places[first], axis=1)
    near = trial.living[np.argsort(distance, kind="stable")]
    near = near[: max(3, int((distance <= half).sum()))]
    corners = places[random.choice(near, 3, replace=False)]
    return Sweep.from_arrays(corners, [[0, 1, 2]])


def again(trial: Trial, half: float) -> Sweep:
    """The last sweep once more, at times a little beside where it was."""
    if trial.last is None:
        return square(trial, half)
    vertices, triangles = trial.last
    aside = trial.random.choice((0.0, 1e-6, 1e-3)) * trial.size * trial.random.normal(size=3)
    return Sweep.from_arrays(vertices + aside, triangles)


SWEEPS: tuple[Callable[[Trial, float], Sweep], ...] = (square, square, wavy, through_nodes, again)


def cut(trial: Trial, way: str | None = None, share: float | None = None) -> None:
    """Cut along a random sweep, now and then with nodes held around a place."""
    random, mesh = trial.random, trial.mesh
    way = way or str(random.choice(list(WAYS)))
    if mesh.sheet_rows is not None and WAYS[way][0] != "split":
        way = "split"
    half = (share or random.choice(SHARES)) * trial.size * random.uniform(0.5, 1.5)
    try:
        sweep = SWEEPS[random.integers(len(SWEEPS))](trial, half)
    except CutError:
        # Three nodes in a line, or at one place.
        trial.missed["cut"] += 1
        return
    trial.last = (sweep.vertices, sweep.triangles)
    cut_along(trial, sweep, way)


def cut_along(trial: Trial, sweep: Sweep, way: str) -> bool:
    """Cut along a sweep and check what is reported; whether anything was cut."""
    mesh, (method, how) = trial.mesh, WAYS[way]
    held = _held(trial)
    try:
        planned = plan(mesh, trial.places, sweep, method, settings=how, held=mesh.node_ids[held])
    except CutError as error:
        if not error.code.nothing_to_cut:
            trial.fault(f"cut refused, {error.code.name}: {error}")
        trial.missed["cut"] += 1
        return False
    report, parts = planned.report, trial.valid.parts
    before, snapped = trial.valid.volume, method == "split" and how.snap
    kept = VOLUME_SNAPPED if snapped else VOLUME_KEPT
    cuts_tissue = len(planned.edit.read_elements) > 0
    name = f"cut: {way}" if cuts_tissue else "threads cut"
    after = trial.carry_out(name, planned.edit, kept, held)
    if after.parts != report.components:
        trial.fault(
            f"{after.parts} parts after a cut, {report.components} reported, {parts} before"
        )
    reported = report.volume_change / before
    if abs(after.volume / before - 1.0 - reported) > VOLUME_KEPT:
        trial.fault(f"rest volume grew by {after.volume / before - 1.0:.3g}, reported otherwise")
    return True


def _held(trial: Trial) -> NDArray[np.int64]:
    """Rows of nodes around a place; none in every second case."""
    random, living = trial.random, trial.living
    if random.integers(2):
        return living[:0]
    distance = np.linalg.norm(trial.places[living] - trial.places[random.choice(living)], axis=1)
    return living[distance < random.uniform(0.0, 0.2) * trial.size]


def tear(trial: Trial) -> None:
    """Pull the organ one way, and tear what is pulled hardest."""
    random, mesh = trial.random, trial.mesh
    _stretch(trial)
    held = _held(trial)
    ids = mesh.node_ids[held]
    if mesh.sheet_rows is not None:
        limit = SheetTearSettings(random.uniform(0.01, 0.2))
        found = plan_sheet_tear(mesh, trial.places, limit, Settings(), ids)
    else:
        limits = TearSettings(
            10.0 ** random.uniform(2.0, 4.0), int(random.integers(1, 60)),
            random.uniform(0.0, 1.0), random.uniform(0.0, 6.0), int(random.integers(1, 8)),
        )  # fmt: skip
        work = work_without_sweep(mesh, trial.places, ids)
        found = plan_tear(work, element_material(MaterialField(mesh, SOFT)), limits)
    if found.edit is None:
        trial.missed["tear"] += 1
        return
    split = mesh.node_rows_of(found.edit.copy_parents)
    if mesh.fixed[split].any() or np.isin(split, held).any():
        trial.fault("fixed or held nodes came apart in a tear")
    trial.carry_out("tear", found.edit, 0.0, held)


def burn(trial: Trial) -> None:
    """Hold a hot tip into the organ for long enough to take some of it away."""
    random, mesh, settings = trial.random, trial.mesh, BurnSettings()
    if mesh.sheet_rows is not None:
        trial.missed["burn"] += 1
        return
    tip = trial.places[random.choice(trial.living)]
    radius = trial.size * random.uniform(0.01, 0.06)
    enough = settings.energy_density / peak_density(settings.power, radius)
    touch = Touch(tip, radius, enough * random.uniform(0.9, 6.0))
    gone = trial.burns.heat(mesh, trial.places, [touch], settings)
    try:
        edit = plan_burn(work_without_sweep(mesh, trial.places), gone)
    except CutError as error:
        if error.code != CutCode.MISSED:
            trial.fault(f"burn refused, {error.code.name}: {error}")
        trial.missed["burn"] += 1
        return
    trial.carry_out("burn", edit)


def patch(trial: Trial) -> None:
    """Lay a patch of a random outline somewhere near a node: one more part."""
    random, places, size = trial.random, trial.places, trial.size
    corners = int(random.integers(3, 9))
    turn = 2.0 * np.pi * (np.arange(corners) + random.uniform(0.0, 0.4, corners)) / corners
    radii = size * random.uniform(0.06, 0.2, (corners, 1))
    x, y, out = np.linalg.qr(random.normal(size=(3, 3)))[0]
    outline = radii * (np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * y)
    centre = places[random.choice(trial.living)] + 0.1 * size * random.normal() * out
    wanted = Wanted(centre + outline, thickness=size * random.uniform(0.005, 0.03))
    try:
        planned = plan_patch(trial.mesh, places, wanted)
    except PatchError as error:
        # Corners that nearly meet are refused, and so are more patches than an organ has.
        if error.code != PatchCode.INVALID:
            trial.fault(f"patch refused, {error.code.name}: {error}")
        trial.missed["patch"] += 1
        return
    parts = trial.valid.parts
    if trial.carry_out("patch", planned.edit).parts != parts + 1:
        trial.fault(f"{trial.valid.parts} parts after a patch was laid, {parts} before")


def sew_rim(trial: Trial) -> None:
    """Sew one of the patches to the tissue around it."""
    random, there = trial.random, list(trial.mesh.patches)
    if not there:
        trial.missed["rim"] += 1
        return
    size = trial.size
    wanted = Sewing(
        np.empty((0, 3)), size * random.uniform(0.02, 0.1), bool(random.integers(2)),
        min(FARTHEST_REACH, 0.5 * size), 0.0, float(random.choice((-1.0, -0.5, 0.0))),
    )  # fmt: skip
    try:
        edit = plan_rim(trial.mesh, trial.places, there[random.integers(len(there))], wanted)
    except SutureError as error:
        if error.code not in (SutureCode.NOTHING_THERE, SutureCode.NO_RIM):
            trial.fault(f"sewing a rim refused, {error.code.name}: {error}")
        trial.missed["rim"] += 1
        return
    trial.carry_out("rim", edit, 0.0)


def sew(trial: Trial) -> None:
    """Sew single stitches or along two lines between places near each other."""
    random, places, size = trial.random, trial.places, trial.size
    first = places[random.choice(trial.living)]
    distance = np.linalg.norm(places[trial.living] - first, axis=1)
    near = places[trial.living[distance < 0.25 * size]]
    ends = near[random.integers(len(near), size=2 * int(random.integers(1, 5)))]
    ends = ends + 0.01 * size * random.normal(size=ends.shape)
    along = len(ends) >= 4 and bool(random.integers(2))
    wanted = Sewing(
        ends, size * random.uniform(0.02, 0.1) if along else 0.0, bool(random.integers(2)),
        min(FARTHEST_REACH, 0.1 * size), 10.0 ** random.uniform(0.0, 4.0),
        float(random.choice((-1.0, -0.5, 0.0, 1e-3))),
    )  # fmt: skip
    try:
        edit = plan_sewing(trial.mesh, places, wanted)
    except SutureError as error:
        if error.code != SutureCode.NOTHING_THERE:
            trial.fault(f"sewing refused, {error.code.name}: {error}")
        trial.missed["sew"] += 1
        return
    trial.carry_out("sew", edit, 0.0)


def tighten(trial: Trial) -> None:
    """Give some stitches another length."""
    _of_some(trial, "tighten", lambda some: plan_tightening(
        trial.mesh, trial.places, some, float(trial.random.choice((-0.8, 0.0, 5e-4)))
    ))  # fmt: skip


def unsew(trial: Trial) -> None:
    """Take some stitches out."""
    _of_some(trial, "unsew", lambda some: plan_removal(trial.mesh, some))


def _of_some(trial: Trial, what: str, planned: Callable[..., object]) -> None:
    table = trial.mesh.sutures
    some = np.flatnonzero(trial.random.random(len(table)) < trial.random.uniform(0.05, 0.6))
    if not len(some):
        trial.missed[what] += 1
        return
    trial.carry_out(what, planned(table.at(some)), 0.0)  # type: ignore[arg-type]


def cut_thread(trial: Trial) -> None:
    """Cut across the middle of a stitch: it must be gone."""
    random, table, places = trial.random, trial.mesh.sutures, trial.places
    lengths = np.linalg.norm(places[table.nodes[:, 1]] - places[table.nodes[:, 0]], axis=1)
    long = np.flatnonzero(lengths > 1e-5)
    if not len(long):
        trial.missed["threads cut"] += 1
        return
    k = int(random.choice(long))
    a, b = places[table.nodes[k]]
    first = np.cross(b - a, random.normal(size=3))
    first *= random.uniform(0.1, 1.0) * lengths[k] / np.linalg.norm(first)
    second = np.cross(b - a, first) / lengths[k]
    middle = 0.5 * (a + b) + 0.05 * (first + second)
    corners = [middle - first - second, middle + first - second, middle + first + second,
               middle - first + second]  # fmt: skip
    sweep = Sweep.from_arrays(corners, [[0, 1, 2], [0, 2, 3]])
    way = "split" if trial.mesh.sheet_rows is not None else str(random.choice(list(WAYS)))
    if not cut_along(trial, sweep, way) or table.ids[k] in trial.mesh.sutures.ids:
        trial.fault("a blade passed the middle of a thread and did not cut it")


def undo(trial: Trial) -> None:
    """Undo up to ten edits."""
    trial.go_back(int(trial.random.integers(1, 11)))


def redo(trial: Trial) -> None:
    """Make up to ten undone edits again."""
    trial.go_on(int(trial.random.integers(1, 11)))


OPERATIONS: dict[Callable[[Trial], None], float] = {
    cut: 0.34, tear: 0.14, burn: 0.06, patch: 0.05, sew_rim: 0.04, sew: 0.1, tighten: 0.04,
    unsew: 0.04, cut_thread: 0.05, undo: 0.08, redo: 0.06,
}  # fmt: skip
"""What a session is made of, and how often."""


def session(trial: Trial, steps: int) -> None:
    """So many operations in random order, then everything undone and made again."""
    operations, shares = list(OPERATIONS), np.array(list(OPERATIONS.values()))
    for _ in range(steps):
        if trial.random.integers(3) == 0:
            deform(trial)
        operations[trial.random.choice(len(operations), p=shares / shares.sum())](trial)
    trial.finish()
