"""The second model of a session is drawn with its difference as colour, each on its own version."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tissue_interfaces.msg import TissueState

from support.rrd import columns, rgb
from support.small_block import CORNER
from support.split_edit import split_at
from support.told_session import PERIOD, ToldSession
from tissue_sim import conversions
from tissue_sim.geometry.mesh import Mesh
from viz_bridge.difference_colors import difference_colors
from viz_bridge.drawn_difference import DrawnDifference
from viz_bridge.organ_surface import surface_of
from viz_bridge.recording import Recording, file_stream


def difference(session: ToldSession, frame: int, version: int, apart: np.ndarray) -> TissueState:
    """What a second model says that is off by some distances along x [m]."""
    stamp = conversions.stamp_of(frame * PERIOD)
    message = TissueState(header=conversions.header("organ", stamp), sim_time=frame / 60)
    message.version, message.frame = version, frame
    message.epoch = conversions.epoch_field(session.simulation.epoch)
    message.scalar_name, message.scalar_unit = "difference from lr", "m"
    positions = session.shapes[frame].copy()
    positions[:, 0] += apart
    conversions.fill_state(message, positions)
    conversions.fill(message.scalar, apart.astype(np.float32))
    return message


@pytest.fixture
def drawn(tmp_path: Path) -> tuple[ToldSession, Recording, Path]:
    session, path = ToldSession("quasi_static"), tmp_path / "session.rrd"
    recording = Recording(file_stream(str(path)))
    session.listen(lambda topic, message: recording.take(topic, message, 0))
    session.pull(4)
    return session, recording, path


def test_the_second_model_has_its_own_shape_and_the_difference_as_colour(
    drawn: tuple[ToldSession, Recording, Path],
) -> None:
    session, recording, path = drawn
    mesh: Mesh = session.simulation.mesh
    apart = np.linspace(0.0, 0.0019, mesh.node_rows)
    recording.take("tissue/difference", difference(session, 3, 1, apart), 0)
    recording.close()
    part, found = surface_of(mesh).outside, columns(path)
    body = found["/difference/outside"]
    assert body["frame"] == [3]
    np.testing.assert_allclose(
        body["Mesh3D:vertex_positions"][0],
        session.shapes[3][part.nodes] + np.outer(apart[part.nodes], [1, 0, 0]),
        atol=1e-7,
    )
    expected = difference_colors(apart[part.nodes], 0.002)
    shown = rgb(body["Mesh3D:vertex_colors"][0])
    assert np.abs(shown.astype(int) - expected).max() <= 2
    np.testing.assert_allclose(
        found["/plots/difference/mean"]["Scalars:scalars"][0], [1e3 * apart.mean()], rtol=1e-5
    )
    assert "Image:buffer" in found["/difference_legend"]


def test_a_second_model_that_lags_is_drawn_on_the_version_it_has(
    drawn: tuple[ToldSession, Recording, Path],
) -> None:
    session, recording, path = drawn
    before = session.simulation.mesh.node_rows
    triangles = surface_of(session.simulation.mesh).outside.triangles
    session.frame(CORNER, True, split_at(session.simulation.mesh, 0.03, top=0.05))
    session.frame(CORNER, True)
    after = session.simulation.mesh.node_rows
    for frame, version, rows in ((4, 1, before), (6, 2, after), (6, 3, after)):
        message = difference(session, frame, version, np.full(rows, 1e-3))
        recording.take("tissue/difference", message, 0)
    recording.close()
    found = columns(path)
    # Not on a version that is not known.
    assert found["/difference/outside"]["frame"] == [4, 6]
    assert found["/difference/outside"]["Mesh3D:triangle_indices"][0] == triangles.tolist()
    assert found["/difference/inside"]["frame"][-1] == 6


def test_the_scale_only_grows(drawn: tuple[ToldSession, Recording, Path]) -> None:
    session, recording, _ = drawn
    picture = DrawnDifference(recording.stream)
    mesh = session.simulation.mesh
    picture.remember(session.simulation.epoch, surface_of(mesh))
    tops = []
    for far in (0.0, 3e-4, 1e-3, 4e-4, 7e-3):
        assert picture.take(difference(session, 1, 1, np.full(mesh.node_rows, far)))
        tops.append(picture.top)
    recording.close()
    np.testing.assert_allclose(tops, [1e-6, 5e-4, 1e-3, 1e-3, 1e-2])
