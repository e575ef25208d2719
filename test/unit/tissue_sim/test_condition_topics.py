"""The material as a message."""

from __future__ import annotations

import pytest
from tissue_interfaces.msg import Material as MaterialMsg

from tissue_sim.condition_topics import material_from_msg, material_to_msg
from tissue_sim.elastic.model import Material, RegionMaterial

EPOCH = bytes(range(16))


def test_a_material_with_regions_comes_through_a_message_as_it_was() -> None:
    regions = (
        RegionMaterial("aorta", 2e5, 0.3, 1100.0),
        RegionMaterial("3", 1e4, 0.45, 1000.0, 7.0),
    )
    material = Material(5e4, 0.4, 1060.0, 2e4, regions)
    message = material_to_msg(material, EPOCH)
    assert bytes(message.epoch) == EPOCH
    assert material_from_msg(message) == material


def test_a_message_that_holds_no_material_is_refused() -> None:
    with pytest.raises(ValueError, match="needs the tissue's own"):
        material_from_msg(MaterialMsg())
    short = material_to_msg(Material(), EPOCH)
    short.poisson_ratio = []
    with pytest.raises(ValueError, match="got 1 regions"):
        material_from_msg(short)
