"""The journal as messages, both ways."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from tissue_interfaces.msg import Command as CommandMsg
from tissue_interfaces.msg import Journal
from tissue_interfaces.msg import ToolSample as ToolSampleMsg
from tissue_interfaces.msg import TopologyEdit as EditMsg

from tissue_sim.conversions import epoch_field, epoch_of, header, nanoseconds_of, stamp_of
from tissue_sim.edit_messages import edit_from_msg
from tissue_sim.frame import Command, FrameInputs, JournalEntry, ToolSample


def entry_to_msg(
    entry: JournalEntry, edits: Sequence[EditMsg], frame_id: str, stamp: Time
) -> Journal:
    """A journal entry as a message.

    Args:
        entry: The entry.
        edits: Its edits as they are published on tissue/edits.
        frame_id: The organ's frame.
        stamp: Start of the frame.
    """
    message = Journal(
        header=header(frame_id, stamp),
        frame=entry.frame,
        version=entry.version,
        sim_time=float(entry.sim_time),
        steps=entry.steps,
        positions_crc32=entry.crc32,
    )
    message.epoch = epoch_field(entry.epoch)
    message.tools = [_sample_to_msg(sample) for sample in entry.inputs.tools]
    message.commands = [
        CommandMsg(
            kind=command.kind,
            request_id=command.request_id,
            arguments=json.dumps(dict(command.arguments)),
        )
        for command in entry.inputs.commands
    ]
    message.edits = list(edits)
    return message


def entry_from_msg(message: Journal) -> JournalEntry:
    """A journal entry from a message of rclpy or of a bag reader."""
    commands = tuple(
        Command(command.kind, json.loads(command.arguments), command.request_id)
        for command in message.commands
    )
    inputs = FrameInputs(
        commands=commands,
        edits=tuple(edit_from_msg(edit) for edit in message.edits),
        tools=tuple(_sample_from_msg(sample) for sample in message.tools),
    )
    return JournalEntry(
        epoch=epoch_of(message),
        frame=int(message.frame),
        version=int(message.version),
        sim_time=float(message.sim_time),
        steps=int(message.steps),
        inputs=inputs,
        crc32=int(message.positions_crc32),
    )


def _sample_to_msg(sample: ToolSample) -> ToolSampleMsg:
    message = ToolSampleMsg(
        id=sample.tool, stamp=stamp_of(sample.stamp), use=bool(sample.use), edge=int(sample.edge)
    )
    message.pose = np.asarray(sample.pose, dtype=np.float64)
    return message


def _sample_from_msg(message: ToolSampleMsg) -> ToolSample:
    edge = int(message.edge)
    return ToolSample(
        tool=message.id,
        pose=np.array([float(value) for value in message.pose]),
        stamp=nanoseconds_of(message.stamp),
        use=bool(message.use),
        edge=1 if edge > 0 else -1 if edge < 0 else 0,
    )
