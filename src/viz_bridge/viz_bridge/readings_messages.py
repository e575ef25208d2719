"""What is told of tissue, as messages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from tissue_interfaces import msg as messages

from tissue_sim.conversions import epoch_field, fill, header
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.readings.fields import UNITS
from tissue_sim.readings.history import Reading
from tissue_sim.readings.regions import RiskRegion
from tissue_sim.readings.risk_warnings import RiskWarning
from tissue_sim.readings.tissue import Told


@dataclass(frozen=True)
class Moment:
    """Which frame something is told of.

    Attributes:
        frame_id: The organ's frame.
        stamp: Time of the frame.
        epoch: Its epoch.
        frame: Its number.
        sim_time: [s] since the epoch began.
    """

    frame_id: str
    stamp: Time
    epoch: bytes
    frame: int
    sim_time: float


def scalar_message(
    moment: Moment, mesh: Mesh, name: str, values: NDArray[np.float64]
) -> messages.NodeScalar:
    """A quantity at every node."""
    message = messages.NodeScalar(
        header=header(moment.frame_id, moment.stamp), version=mesh.version, frame=moment.frame,
        name=name, unit=UNITS[name],
    )  # fmt: skip
    message.epoch = epoch_field(moment.epoch)
    fill(message.values, values)
    return message


def readings_message(moment: Moment, mesh: Mesh, told: Told) -> messages.Readings:
    """All readings and warnings of a frame."""
    message = messages.Readings(
        header=header(moment.frame_id, moment.stamp), version=mesh.version, frame=moment.frame,
        sim_time=moment.sim_time,
        readings=[_reading(mesh, reading) for reading in told.readings],
        warnings=[_warning(warning) for warning in told.warnings],
    )  # fmt: skip
    message.epoch = epoch_field(moment.epoch)
    return message


def regions_message(
    frame_id: str, stamp: Time, epoch: bytes, regions: Iterable[RiskRegion]
) -> messages.RiskRegions:
    """The risk regions there are."""
    message = messages.RiskRegions(header=header(frame_id, stamp))
    message.epoch = epoch_field(epoch)
    for region in regions:
        one = messages.RiskRegion(
            name=region.name, margin=region.margin, stress_limit=region.stress_limit
        )
        fill(one.nodes, region.nodes)
        message.regions.append(one)
    return message


def _reading(mesh: Mesh, reading: Reading) -> messages.Reading:
    return messages.Reading(
        name=reading.name, unit=UNITS[reading.name], peak=reading.peak,
        peak_node=int(mesh.node_ids[reading.peak_row]), mean=reading.mean,
        highest=reading.highest, highest_at=reading.highest_at, integrated=reading.integrated,
    )  # fmt: skip


def _warning(warning: RiskWarning) -> messages.RiskWarning:
    cause = warning.cause
    return messages.RiskWarning(
        region=cause.region, what=cause.what, tool=cause.tool, value=float(warning.value),
        begins=warning.begins,
    )  # fmt: skip
