"""Burning, as in electrosurgery: tissue near a tool's tip takes up heat and is gone.

A tool of power P [W] and radius R [m] heats what is within R of its tip, most at the tip: an
element at distance r takes up q = 15 P / (8 pi R^3) (1 - r^2 / R^2) [W/m^3], which adds up to P
over the ball. An element is removed when it has taken up the energy density that makes tissue
steam. No heat is conducted away: see docs/tearing.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cut_service.errors import CutCode, CutError
from cut_service.removal import take_out
from cut_service.work import Work
from tissue_sim.geometry.edit import NO_PARENT, EditChange, TopologyEdit
from tissue_sim.geometry.mesh import Mesh

Rows = NDArray[np.int32]
Reals = NDArray[np.float64]

SMALLEST, LARGEST = 1e-6, 10.0
"""Allowed radii [m]."""


class BurnError(ValueError):
    """A radius, a power or an energy density that makes no sense."""


@dataclass(frozen=True)
class BurnSettings:
    """How tissue burns.

    Attributes:
        power: Power of a burning tool [W].
        energy_density: What an element takes up before it is gone [J/m^3].
    """

    power: float = 30.0
    energy_density: float = 2.2e9

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            BurnError: Naming what is wrong and what is allowed.
        """
        for name, low, high in (("power", 0.0, 1e6), ("energy_density", 1.0, 1e15)):
            value = getattr(self, name)
            if not math.isfinite(value) or not low <= value <= high:
                raise BurnError(f"{name} = {value:g} is not allowed; allowed: {low:g} to {high:g}")


@dataclass(frozen=True)
class Touch:
    """A burning tool for a moment.

    Attributes:
        tip: Where its tip is [m], shape (3,).
        radius: Of what it heats [m].
        seconds: For how long [s].
    """

    tip: Reals
    radius: float
    seconds: float

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            BurnError: Naming what is wrong and what is allowed.
        """
        if not math.isfinite(self.radius) or not SMALLEST <= self.radius <= LARGEST:
            raise BurnError(
                f"burn radius {self.radius:g} m is not allowed; allowed: {SMALLEST:g} to "
                f"{LARGEST:g} m"
            )
        if np.shape(self.tip) != (3,) or not np.isfinite(self.tip).all():
            raise BurnError("the tip of a burning tool is not finite")
        if not math.isfinite(self.seconds) or self.seconds < 0.0:
            raise BurnError(f"a tool burns for {self.seconds:g} s; allowed: 0 or more")


@njit(cache=True, nogil=True)
def _heat(
    places: Reals,
    tets: Rows,
    alive: NDArray[np.bool_],
    tips: Reals,
    radii: Reals,
    doses: Reals,
    energy: Reals,
    heated: Rows,
) -> int:
    """Add what each touch brings to each element's energy density; rows heated, their number.

    `doses` is the energy density that a touch brings at its tip.
    """
    low, high = tips[0] - radii[0], tips[0] + radii[0]
    for t in range(1, tips.shape[0]):
        low = np.minimum(low, tips[t] - radii[t])
        high = np.maximum(high, tips[t] + radii[t])
    number = 0
    for e in range(tets.shape[0]):
        if not alive[e]:
            continue
        i, j, k, m = tets[e, 0], tets[e, 1], tets[e, 2], tets[e, 3]
        x = 0.25 * (places[i, 0] + places[j, 0] + places[k, 0] + places[m, 0])
        if x < low[0] or x > high[0]:
            continue
        y = 0.25 * (places[i, 1] + places[j, 1] + places[k, 1] + places[m, 1])
        z = 0.25 * (places[i, 2] + places[j, 2] + places[k, 2] + places[m, 2])
        total = 0.0
        for t in range(tips.shape[0]):
            square = (x - tips[t, 0]) ** 2 + (y - tips[t, 1]) ** 2 + (z - tips[t, 2]) ** 2
            total += doses[t] * max(0.0, 1.0 - square / radii[t] ** 2)
        if total > 0.0:
            energy[e] += total
            heated[number] = e
            number += 1
    return number


class Burns:
    """How much heat each element of a mesh has taken up.

    Attributes:
        energy: Energy density by element row [J/m^3]; rows beyond it have none.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Another organ: nothing has been heated."""
        self.energy, self._due = np.zeros(0), np.empty(0, dtype=np.int32)

    @property
    def waiting(self) -> bool:
        """Whether elements that have had enough were still there when last looked at."""
        return len(self._due) > 0

    def heat(self, mesh: Mesh, places: Reals, touches: list[Touch], settings: BurnSettings) -> Rows:
        """Heat what is near the tips.

        Args:
            mesh: The mesh.
            places: Current node positions [m], shape (node_rows, 3).
            touches: Where tools have burned since the last call.
            settings: How tissue burns.

        Returns:
            Rows of the elements that have had enough and are still there, ascending.
        """
        self._make_room(mesh.element_rows)
        if touches:
            heated = self._heated(mesh, places, touches, settings)
            self._due = np.union1d(self._due, heated).astype(np.int32)
        there = mesh.element_alive[self._due] & (self.energy[self._due] >= settings.energy_density)
        self._due = self._due[there]
        return self._due

    def _heated(
        self, mesh: Mesh, places: Reals, touches: list[Touch], settings: BurnSettings
    ) -> Rows:
        radii = np.array([touch.radius for touch in touches])
        seconds = np.array([touch.seconds for touch in touches])
        heated = np.empty(mesh.element_rows, dtype=np.int32)
        number = _heat(
            places, mesh.tets[: mesh.element_rows], mesh.element_alive[: mesh.element_rows],
            np.array([touch.tip for touch in touches], dtype=np.float64), radii,
            seconds * peak_density(settings.power, 1.0) / radii**3, self.energy, heated,
        )  # fmt: skip
        return heated[:number]

    def follow(self, mesh: Mesh, change: EditChange) -> None:
        """Follow an edit: parts of an element are as hot as it was; what comes back is cold.

        A patch is cold too.

        Args:
            mesh: The mesh, after the edit.
            change: What the edit touched.
        """
        self._make_room(mesh.element_rows)
        edit = change.edit
        added = mesh.element_rows_of(edit.added_elements)
        parents = edit.added_parents.astype(np.int64)
        descends = parents != NO_PARENT
        # Parents may be gone by now: within a session ids are rows.
        self.energy[added] = np.where(descends, self.energy[np.where(descends, parents, 0)], 0.0)
        self.energy[mesh.element_rows_of(edit.returned_elements)] = 0.0

    def _make_room(self, rows: int) -> None:
        if len(self.energy) < rows:
            self.energy = np.concatenate([self.energy, np.zeros(rows - len(self.energy))])


def peak_density(power: float, radius: float) -> float:
    """Heat per volume and time at the tip of a tool [W/m^3].

    Args:
        power: Of the tool [W].
        radius: Of what it heats [m].
    """
    return 15.0 * power / (8.0 * math.pi * radius**3)


def plan_burn(work: Work, elements: Rows) -> TopologyEdit:
    """Plan to remove elements that are gone.

    Args:
        work: The plan's.
        elements: Their rows, ascending, shape (n,).

    Raises:
        CutError: There is none, or nothing would be left.
    """
    if not len(elements):
        raise CutError(CutCode.MISSED, "nothing has burned away")
    return take_out(work, elements, "burn")[3]
