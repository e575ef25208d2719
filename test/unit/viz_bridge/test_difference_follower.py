"""A second model beside a session is that session's own where they are the same."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from support.small_block import CORNER
from support.split_edit import split_at
from support.told_session import ToldSession
from tissue_sim.compare.subject import parse_subject
from tissue_sim.frame import Command
from viz_bridge.difference_follower import Compared, DifferenceFollower
from viz_bridge.session_shapes import MOST, SessionShapes


class Listener:
    """A follower that plays what comes at once, or when it is told to."""

    def __init__(self, model: str, at_once: bool = True, keep_up: bool = False) -> None:
        self.follower = DifferenceFollower(parse_subject(model), keep_up)
        self.found: list[Compared] = []
        self._at_once = at_once

    def take(self, topic: str, message: Any) -> None:
        self.follower.take(topic, message)
        if self._at_once:
            self.play()

    def play(self) -> None:
        played = True
        while played:
            played, compared = self.follower.advance()
            self.found += [compared] if compared is not None else []

    @property
    def distances(self) -> np.ndarray:
        return np.array([compared.mean for compared in self.found])


def long_session(session: ToldSession) -> None:
    """Pull, let go, cut, take hold again where the tissue is then, and pull elsewhere."""
    session.pull(8)
    session.frame(CORNER, False)
    session.frame(CORNER, False, split_at(session.simulation.mesh, 0.03, top=0.05))
    model = Command("set_model", {"model": "relaxation", "parameters": {}}, "m")
    session.frame(CORNER, False, commands=(model,))
    session.pull(6, far=-0.01)


@pytest.mark.parametrize(
    ("model", "steps"), [("quasi_static", 3), ("lr", 2), ("spring_mass", None)]
)
def test_the_same_model_makes_no_difference_at_all(model: str, steps: int | None) -> None:
    session, listener = ToldSession(model, steps), Listener(model)
    session.listen(listener.take)
    session.pull(6)
    session.frame(CORNER, False)
    session.frame(CORNER, False, split_at(session.simulation.mesh, 0.03, top=0.05))
    session.pull(6, far=-0.01)
    assert [compared.entry.frame for compared in listener.found] == list(range(1, 15))
    assert listener.found[-1].entry.version == 2
    assert max(compared.largest for compared in listener.found) == 0.0
    assert listener.found[-1].relative == 0.0


def test_another_model_differs_but_not_where_tissue_is_held_or_fixed() -> None:
    session, listener = ToldSession("relaxation", steps=1), Listener("finite_element@rest")
    session.listen(listener.take)
    session.pull(10)
    last, simulation = listener.found[-1], session.simulation
    mesh = simulation.mesh
    assert last.mean > 1e-4
    assert last.mean <= last.p95 <= last.largest
    assert 0.0 < last.relative < 2.0
    np.testing.assert_allclose(last.distance[simulation.holds.rows], 0.0, atol=1e-7)
    np.testing.assert_allclose(last.distance[mesh.fixed[: mesh.node_rows]], 0.0, atol=1e-7)
    apart = np.linalg.norm(last.positions - session.shapes[10], axis=1)
    np.testing.assert_allclose(last.distance, apart, atol=1e-7)


def test_a_second_hold_takes_the_nodes_that_it_takes_in_the_session() -> None:
    session, listener = ToldSession("relaxation", steps=1), Listener("finite_element@rest")
    session.listen(listener.take)
    session.pull(8, far=0.03)
    session.frame(CORNER, False)
    # Where the two shapes are far apart.
    place = session.shapes[9][session.simulation.mesh.node_rows - 1].astype(float)
    session.frame(place, True)
    second = listener.follower.second
    assert second is not None
    held = session.simulation.holds.rows
    assert len(held)
    np.testing.assert_array_equal(second.simulation.holds.rows, held)
    np.testing.assert_allclose(listener.found[-1].distance[held], 0.0, atol=1e-7)


def test_nothing_of_the_journal_is_dropped_however_late_it_is_played() -> None:
    session, at_once = ToldSession("quasi_static"), Listener("lr@4")
    late = Listener("lr@4", at_once=False)
    session.listen(at_once.take)
    session.listen(late.take)
    long_session(session)
    assert late.follower.waiting == 17
    assert late.follower.lag == pytest.approx(16 / 60, abs=1e-3)
    late.play()
    assert late.follower.lag == 0.0
    np.testing.assert_array_equal(late.distances, at_once.distances)
    np.testing.assert_array_equal(late.found[-1].positions, at_once.found[-1].positions)


def test_frames_passed_over_do_not_change_an_equilibrium() -> None:
    session = ToldSession("quasi_static")
    every = Listener("finite_element:tolerance=1e-6@rest")
    some = Listener("finite_element:tolerance=1e-6@rest", at_once=False, keep_up=True)
    session.listen(every.take)
    session.listen(some.take)
    long_session(session)
    some.play()
    assert len(some.found) < len(every.found) == 17
    assert some.found[-1].entry.frame == 17
    scale = np.abs(every.found[-1].positions).max()
    np.testing.assert_allclose(
        some.found[-1].positions, every.found[-1].positions, atol=1e-3 * scale
    )


def test_who_joins_late_begins_with_the_shape_and_the_holds_of_that_moment() -> None:
    session = ToldSession("finite_element", steps=30)
    session.pull(6)
    session.frame(CORNER, True, split_at(session.simulation.mesh, 0.03, top=0.05))
    listener = Listener("finite_element@rest")
    session.listen(listener.take)
    session.pull(5, start=1)
    second = listener.follower.second
    assert second is not None
    assert listener.follower.joined >= 8
    np.testing.assert_array_equal(second.simulation.holds.rows, session.simulation.holds.rows)
    assert listener.found[-1].entry.version == 2
    # Both are in equilibrium, the session's to within its 30 iterations a frame.
    assert listener.found[-1].mean < 2e-4
    assert np.isfinite(listener.distances).all()


def test_an_undo_of_what_was_before_it_joined_makes_it_join_again() -> None:
    session = ToldSession("quasi_static")
    session.frame(CORNER, False)
    session.frame(CORNER, False, split_at(session.simulation.mesh, 0.03, top=0.05))
    listener = Listener("lr")
    session.listen(listener.take)
    session.pull(4)
    first = listener.follower.joined
    undo = Command("undo", {"author": ""}, "u")
    session.frame(CORNER, True, commands=(undo,))
    session.pull(4)
    assert session.simulation.mesh.version == 3
    assert listener.follower.joined > first > 0
    assert listener.found[-1].entry.version == 3
    assert listener.follower.problem == ""


def test_a_lost_frame_of_the_journal_makes_it_join_again() -> None:
    session, listener = ToldSession("quasi_static"), Listener("quasi_static")

    def lossy(topic: str, message: Any) -> None:
        if not (topic == "tissue/journal" and message.frame == 5):
            listener.take(topic, message)

    session.listen(lossy)
    session.pull(12)
    assert listener.follower.joined > 5
    assert listener.found[-1].entry.frame == 12
    assert listener.found[-1].mean < 1e-4


def test_what_cannot_follow_a_session_is_refused_or_told() -> None:
    with pytest.raises(ValueError, match=r"springs\.stiffness cannot be set.*allowed"):
        DifferenceFollower(parse_subject("quasi_static:springs.stiffness=2"))
    session = ToldSession("quasi_static")
    unstable = Listener("spring_mass:time_step=0.01,integrator=0")
    session.listen(unstable.take)
    session.pull(3)
    assert "cannot follow" in unstable.follower.problem
    assert not unstable.found


def test_shapes_that_wait_are_bounded_and_spread_over_the_whole_time() -> None:
    shapes = SessionShapes()
    for frame in range(1, 5001):
        shapes.put(b"one", frame, np.full((1, 3), frame, dtype=np.float32))
    assert len(shapes) <= MOST
    assert shapes.at(b"one", 1) is not None
    assert shapes.at(b"one", 5000) is not None
    assert shapes.before(b"one", 5001) is not None
    assert shapes.at(b"other", 5000) is None
    shapes.put(b"other", 1, np.zeros((1, 3), dtype=np.float32))
    assert len(shapes) == 1
