"""PyBullet's deformable body: neo-Hookean tetrahedra, damping implicit, elasticity not."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.peers.task import Task

SETTINGS: tuple[dict[str, Any], ...] = tuple(
    {"time_step": time_step, "damping": damping}
    for time_step in (1 / 1000, 1 / 480, 1 / 240, 1 / 120)
    for damping in (0.003, 0.01, 0.03)
)
"""Settings tried: `time_step` [s] and `damping`, a share of Lame's constants."""


class BulletSoft:
    """Nodes that are fixed or held are anchored to the world, which takes their mass away.

    Bullet's energy is that of Smith and others with their own constants, mu = 4/3 mu_L and lam =
    lam_L + 5/6 mu_L. Gravity, self-collision and mass springs are off.
    """

    def __init__(self, task: Task, settings: dict[str, Any]) -> None:
        """Load the body from a temporary file.

        Raises:
            ImportError: PyBullet is not installed.
        """
        with _no_output():
            import pybullet

        self._bullet, self._task = pybullet, task
        lam, mu = task.lame
        with _no_output(), tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "tissue.vtk"
            write_vtk(file, task.points, task.tets)
            self._world = pybullet.connect(pybullet.DIRECT)
            world = {"physicsClientId": self._world}
            pybullet.resetSimulation(pybullet.RESET_USE_DEFORMABLE_WORLD, **world)
            pybullet.setGravity(0, 0, 0, **world)
            pybullet.setTimeStep(settings["time_step"], **world)
            self._body = pybullet.loadSoftBody(
                str(file), mass=float(task.masses.sum()), useNeoHookean=1,
                NeoHookeanMu=4 / 3 * mu, NeoHookeanLambda=lam + 5 / 6 * mu,
                NeoHookeanDamping=settings["damping"], useMassSpring=0, useBendingSprings=0,
                useSelfCollision=0, collisionMargin=1e-4, **world,
            )  # fmt: skip
        for node in np.flatnonzero(~task.free):
            pybullet.createSoftBodyAnchor(self._body, int(node), -1, -1, **world)

    def pull(self) -> None:
        """Put the held nodes where they are pulled to."""
        positions = self._positions()
        positions[self._task.held] = self._task.points[self._task.held] + self._task.vector
        self._bullet.resetMeshData(self._body, positions.tolist(), physicsClientId=self._world)

    def step(self) -> None:
        """One time step."""
        self._bullet.stepSimulation(physicsClientId=self._world)

    def displacement(self) -> NDArray[np.floating]:
        """Displacements of all nodes [m]."""
        return self._positions() - self._task.points

    def close(self) -> None:
        """End the world."""
        self._bullet.disconnect(physicsClientId=self._world)

    def _positions(self) -> NDArray[np.float64]:
        bullet = self._bullet
        mesh = bullet.getMeshData(
            self._body, -1, flags=bullet.MESH_DATA_SIMULATION_MESH, physicsClientId=self._world
        )
        return np.array(mesh[1])


def write_vtk(file: Path, points: NDArray[np.float64], tets: NDArray[np.int64]) -> None:
    """Write tetrahedra as the legacy VTK text that Bullet reads."""
    with file.open("w", encoding="ascii") as out:
        out.write("# vtk DataFile Version 2.0\ntissue\nASCII\nDATASET UNSTRUCTURED_GRID\n")
        out.write(f"POINTS {len(points)} double\n")
        np.savetxt(out, points, fmt="%.17g")
        out.write(f"\nCELLS {len(tets)} {5 * len(tets)}\n")
        np.savetxt(out, np.column_stack([np.full(len(tets), 4), tets]), fmt="%d")
        out.write(f"\nCELL_TYPES {len(tets)}\n")
        out.write("10\n" * len(tets))


@contextlib.contextmanager
def _no_output() -> Iterator[None]:
    """Bullet prints what it has loaded, past Python's own output."""
    sys.stdout.flush()
    kept = os.dup(1)
    with open(os.devnull, "w", encoding="ascii") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
