"""What a bag says about a session: the keyframe each epoch began with, and its journal."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from tissue_sim.frame import JournalEntry
from tissue_sim.geometry.holes import Hole
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.journal import JournalError


@dataclass
class RecordedEpoch:
    """One epoch of a recorded session.

    Attributes:
        epoch: Its id.
        mesh: Its first keyframe; None if the bag has none.
        entries: Its journal in the order of frames.
        organ: Name of the geometry.
        holes: Holes that were named, by name, as they were named last.
    """

    epoch: bytes
    mesh: Mesh | None = None
    entries: list[JournalEntry] = field(default_factory=list)
    organ: str = ""
    holes: dict[str, Hole] = field(default_factory=dict)

    @property
    def start(self) -> Mesh:
        """Its first keyframe.

        Raises:
            JournalError: The bag has none.
        """
        if self.mesh is None:
            raise JournalError(
                f"the bag holds no tissue/topology of epoch {self.epoch.hex()} to replay on"
            )
        return self.mesh


def read_epochs(bag: Path, namespace: str | None = None) -> list[RecordedEpoch]:
    """The epochs of a bag that have a journal, in the order they were recorded.

    Args:
        bag: Bag directory or MCAP file.
        namespace: Namespace of the organ; None if there is only one.

    Raises:
        ValueError: The bag cannot be read or holds no journal.
    """
    # Here, so that the numeric library and the command's help need no ROS.
    from tissue_sim.conversions import epoch_of, topology_to_mesh
    from tissue_sim.hole_messages import hole_from_msg
    from tissue_sim.journal_messages import entry_from_msg
    from viz_bridge.bag_reader import only_namespace, read_bag

    prefix = only_namespace(bag, namespace)
    topology, journal = f"{prefix}/tissue/topology", f"{prefix}/tissue/journal"
    holes = f"{prefix}/tissue/holes"
    epochs: dict[bytes, RecordedEpoch] = {}
    for item in read_bag(bag, (topology, journal, holes)):
        message = item.message
        name = epoch_of(message)
        found = epochs.setdefault(name, RecordedEpoch(name))
        if item.topic == journal:
            found.entries.append(entry_from_msg(message))
        elif item.topic == holes:
            found.holes |= {str(hole.name): hole_from_msg(hole) for hole in message.holes}
        elif message.version == 1 and found.mesh is None:
            found.mesh, found.organ = topology_to_mesh(message), str(message.organ)
    with_journal = [epoch for epoch in epochs.values() if epoch.entries]
    if not with_journal:
        raise JournalError(f"{bag} holds no {journal}")
    for epoch in with_journal:
        epoch.entries.sort(key=lambda entry: entry.frame)
    return with_journal
