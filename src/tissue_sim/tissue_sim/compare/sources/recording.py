"""An interaction out of a bag, and how the tissue was measured to move in it.

A bag of a session (`tissue run`, `tissue bag record`) holds the mesh and the journal: its replay
says bit for bit which nodes were held in every frame and where. A bag with nothing but the tools'
topics, such as that of a robot, is played to the organ that is given with it.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.interaction import Interaction, InteractionError
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.sources.held_frames import HeldFrames
from tissue_sim.compare.sources.recorded import Recording
from tissue_sim.compare.sources.tool_tracks import has_tools, play_tools
from tissue_sim.compare.trajectory import Trajectory
from tissue_sim.frame import JournalEntry
from tissue_sim.journal import replay, scene_of
from tissue_sim.session_bag import RecordedEpoch, read_epochs

JOURNAL = "tissue/journal"
STATE = "tissue/state"


def read_recording(
    bag: Path,
    namespace: str | None = None,
    rate_hz: float = 30.0,
    epoch: int | None = None,
    organ: Organ | None = None,
) -> Recording:
    """The interaction that a bag holds.

    Args:
        bag: Bag directory or MCAP file.
        namespace: Namespace of the organ; None if there is only one.
        rate_hz: Frames per second [1/s]; of the recorded ones, the newest at each time.
        epoch: Which epoch, counted from 1; None if there is only one.
        organ: The organ it must be of; None: the bag's. A bag of tools only needs one.

    Raises:
        ValueError: The bag cannot be read, is empty, holds no interaction or that of another organ,
            or several; the message says what is there.
    """
    # Here, because viz_bridge depends on this package.
    from viz_bridge.bag_reader import topic_counts

    topics = sorted(topic for topic, count in topic_counts(bag).items() if count)
    if not topics:
        raise InteractionError(f"{bag} is empty: it holds no message")
    if any(topic.endswith("/" + JOURNAL) for topic in topics):
        return _session(bag, namespace, rate_hz, epoch, organ)
    if not has_tools(topics):
        raise InteractionError(
            f"{bag} holds no {JOURNAL} and no tools/<tool>/servo_cp and use; "
            f"its topics: {', '.join(topics)}"
        )
    if organ is None:
        raise InteractionError(
            f"{bag} holds tools only, no {JOURNAL}: name the organ that they are played to"
        )
    return play_tools(bag, organ, rate_hz)


def _session(
    bag: Path, namespace: str | None, rate_hz: float, which: int | None, organ: Organ | None
) -> Recording:
    epoch = _chosen(bag, read_epochs(bag, namespace), which)
    scene = scene_of(epoch.entries[0])
    if scene.displacement is not None:
        raise InteractionError(
            f"{bag}: its epoch begins with tissue that is deformed already; models are compared "
            "from rest"
        )
    name = bag.resolve().stem
    here = Organ(epoch.organ or name, copy.deepcopy(epoch.start), scene.material)
    organ = _same(bag, here, organ)
    frames = HeldFrames()
    uncut = list(_before_edits(epoch.entries))
    if not uncut:
        raise InteractionError(f"{bag}: its first frame changes the mesh")
    result = replay(uncut, epoch.start, on_frame=lambda simulation, _: frames.take(simulation))
    interaction, numbers = frames.interaction(name, organ, scene.rate_hz, rate_hz)
    notes = frames.notes()
    if len(uncut) < len(epoch.entries):
        notes += (
            f"only frames 1 to {len(uncut)} of {len(epoch.entries)} are taken: the next one "
            "changes the mesh",
        )
    if result.mismatches:
        notes += (
            f"{len(result.mismatches)} frames of the replay differ from the recorded ones, the "
            f"first is {result.mismatches[0]}: this machine or version computes otherwise",
        )
    held = replace(organ, hold=interaction.held_rows(0))
    try:
        measured = _measured(bag, namespace, epoch, held, interaction, numbers, scene.rate_hz)
    except InteractionError as error:
        return Recording(held, interaction, None, notes, str(error))
    return Recording(held, interaction, measured, notes, "")


def _chosen(bag: Path, epochs: list[RecordedEpoch], which: int | None) -> RecordedEpoch:
    if which is None and len(epochs) == 1:
        return epochs[0]
    if which is not None and 1 <= which <= len(epochs):
        return epochs[which - 1]
    there = ", ".join(
        f"{number} ({epoch.organ or 'no mesh'}, {len(epoch.entries)} frames)"
        for number, epoch in enumerate(epochs, 1)
    )
    wanted = "holds several epochs; choose one" if which is None else f"has no epoch {which}"
    raise InteractionError(f"{bag} {wanted}: {there}")


def _same(bag: Path, recorded: Organ, wanted: Organ | None) -> Organ:
    if wanted is None or wanted.digest == recorded.digest:
        return wanted or recorded
    raise InteractionError(
        f"{bag} was recorded on another topology ({recorded.name}, {recorded.mesh.node_rows} "
        f"nodes, {recorded.mesh.element_rows} elements) than {wanted.name} "
        f"({wanted.mesh.node_rows} nodes, {wanted.mesh.element_rows} elements)"
    )


def _before_edits(entries: Iterable[JournalEntry]) -> Iterator[JournalEntry]:
    for entry in entries:
        if entry.version > 1:
            return
        yield entry


def _measured(
    bag: Path,
    namespace: str | None,
    epoch: RecordedEpoch,
    organ: Organ,
    interaction: Interaction,
    numbers: NDArray[np.int64],
    recorded_hz: float,
) -> Trajectory:
    """Positions of tissue/state in the frames of an interaction, the newest there are.

    Raises:
        InteractionError: They are not recorded often enough.
    """
    from tissue_sim.conversions import epoch_of, positions_from_state
    from viz_bridge.bag_reader import only_namespace, read_bag

    topic = f"{only_namespace(bag, namespace)}/{STATE}"
    displacement = np.zeros((len(numbers), organ.mesh.node_rows, 3), dtype=np.float32)
    source = np.zeros(len(numbers), dtype=np.int64)
    for item in read_bag(bag, (topic,)):
        message = item.message
        if epoch_of(message) != epoch.epoch or message.version > 1:
            continue
        # Of every frame from this state on, until a newer one is read.
        row = int(np.searchsorted(numbers, message.frame))
        if row < len(numbers):
            displacement[row] = positions_from_state(message) - organ.rest
            source[row] = message.frame
    if not source.any():
        raise InteractionError(f"{bag} holds no {topic} of these frames")
    for row in range(1, len(source)):
        if not source[row]:
            source[row], displacement[row] = source[row - 1], displacement[row - 1]
    stale = int((numbers - source).max())
    if stale >= recorded_hz / interaction.rate_hz:
        raise InteractionError(
            f"its positions are up to {1e3 * stale / recorded_hz:.0f} ms old where "
            f"{interaction.rate_hz:g} frames a second want new ones every "
            f"{1e3 / interaction.rate_hz:.0f} ms: record with --record-state-hz 60 (tissue run, "
            "tissue bag record), or ask for fewer frames a second"
        )
    none = np.empty(0)
    return Trajectory(
        f"measured in {interaction.name}", interaction.rate_hz, displacement,
        none.astype(np.int64), none, len(numbers), organ.digest,
    )  # fmt: skip
