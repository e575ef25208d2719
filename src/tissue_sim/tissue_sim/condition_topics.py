"""What others plan by, besides topology and shape: the material, and which nodes are held."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.node import Node
from tissue_interfaces.msg import HeldNodes
from tissue_interfaces.msg import Material as MaterialMsg

from tissue_sim import conversions, qos
from tissue_sim.elastic.model import Material, RegionMaterial
from tissue_sim.simulation import Simulation

_NUMBERS = ("young_modulus", "poisson_ratio", "density", "fibre_stiffness")


class ConditionTopics:
    """Publishes `tissue/material` and `tissue/held_nodes`, latched, when they change."""

    def __init__(self, node: Node, frame_id: str) -> None:
        self._frame_id = frame_id
        self._material = node.create_publisher(MaterialMsg, "tissue/material", qos.LATCHED)
        self._held = node.create_publisher(HeldNodes, "tissue/held_nodes", qos.LATCHED)
        self._epoch = b""
        self._held_before: tuple[object, ...] = ()

    def publish(self, simulation: Simulation, stamp: Time) -> None:
        """Publish what has changed since the last call."""
        if simulation.epoch != self._epoch:
            self._epoch = simulation.epoch
            message = material_to_msg(simulation.scene.material, simulation.epoch)
            message.header = conversions.header(self._frame_id, stamp)
            self._material.publish(message)
        holds = simulation.holds.by_id.values()
        # Only an edit or another hold changes which nodes a hold has, or a release lets it take.
        now = (
            simulation.epoch, simulation.mesh.version if holds else 0,
            tuple((hold.id, len(hold.rows)) for hold in holds),
        )  # fmt: skip
        if now == self._held_before:
            return
        self._held_before = now
        held = HeldNodes(
            header=conversions.header(self._frame_id, stamp), version=simulation.mesh.version
        )
        held.epoch = conversions.epoch_field(simulation.epoch)
        conversions.fill(held.nodes, simulation.mesh.node_ids[simulation.holds.rows])
        self._held.publish(held)


def material_to_msg(material: Material, epoch: bytes) -> MaterialMsg:
    """A material as a message without a header."""
    message = MaterialMsg(regions=[part.region for part in material.parts])
    message.epoch = conversions.epoch_field(epoch)
    for name in _NUMBERS:
        values = np.array([getattr(part, name) for part in material.parts])
        conversions.fill(getattr(message, name), values)
    return message


def material_from_msg(message: MaterialMsg) -> Material:
    """The material that a message holds.

    Raises:
        ValueError: It holds none, or its fields do not fit together.
    """
    count = len(message.regions)
    lengths = {name: len(getattr(message, name)) for name in _NUMBERS}
    if not count or message.regions[0] or set(lengths.values()) != {count}:
        raise ValueError(
            f"a material needs the tissue's own and one of every number for each region; "
            f"got {count} regions, {lengths}"
        )
    parts = [
        RegionMaterial(region, *(float(getattr(message, name)[k]) for name in _NUMBERS))
        for k, region in enumerate(message.regions)
    ]
    own = parts[0]
    return Material(
        own.young_modulus, own.poisson_ratio, own.density, own.fibre_stiffness, tuple(parts[1:])
    )
