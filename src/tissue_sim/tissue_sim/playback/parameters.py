"""Parameters of a simulation that plays a recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tissue_sim.parameters import Spec
from tissue_sim.playback.checkpoints import Checkpoints
from tissue_sim.playback.clock import FASTEST, SLOWEST, PlaybackClock
from tissue_sim.playback.player import Player
from tissue_sim.playback.recorded_states import RecordedStates
from tissue_sim.playback.recording import read_recording

PARAMETERS = (
    Spec("playback.bag", "string", "", "Bag to play instead of a scene; empty: none."),
    Spec("playback.namespace", "string", "", "Namespace of the organ in it, if it has several."),
    Spec(
        "playback.rate", "double", 1.0, "Recorded seconds a second.",
        minimum=SLOWEST, maximum=FASTEST,
    ),
    Spec("playback.paused", "bool", False, "Whether it begins paused."),
    Spec("playback.loop", "bool", False, "Whether it begins again at its end."),
    Spec("playback.states", "bool", False, "Whether recorded states are shown, not simulated."),
    Spec(
        "playback.memory_mb", "double", 1024.0, "For states to go back to; 0: none are kept.",
        unit="MB", minimum=0.0, maximum=1e6,
    ),
)  # fmt: skip


def player_of(values: Mapping[str, Any]) -> Player:
    """What plays the bag that parameters name.

    Raises:
        ValueError: The bag cannot be played.
    """
    bag, namespace = Path(values["playback.bag"]), values["playback.namespace"] or None
    recording = read_recording(bag, namespace)
    states = RecordedStates(bag, namespace, recording) if values["playback.states"] else None
    return Player(recording, Checkpoints(int(1e6 * values["playback.memory_mb"])), states)


def clock_of(values: Mapping[str, Any]) -> PlaybackClock:
    """How fast it is played at first."""
    return PlaybackClock(
        values["playback.rate"], values["playback.paused"], values["playback.loop"]
    )
