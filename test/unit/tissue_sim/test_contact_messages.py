"""Contact models travel as messages without a change, and broken ones are refused."""

from __future__ import annotations

import numpy as np
import pytest

from tissue_sim import conversions
from tissue_sim.contact_messages import contact_from_msg, contact_to_msg
from tissue_sim.interaction.contact_model import ContactModel


def model() -> ContactModel:
    rng = np.random.default_rng(3)
    half = rng.normal(size=(6, 6))
    pose = np.array([0.1, -0.2, 0.3, 0.0, 0.6, 0.0, 0.8])
    return ContactModel(pose, rng.normal(size=6), half @ half.T, half.T @ half, 0.1, 0.01, True)


def test_a_contact_model_travels_as_it_is() -> None:
    sent = model()
    message = contact_to_msg(sent, "finger", "organ", conversions.stamp_of(1_500_000_000))
    assert (message.tool, message.header.frame_id) == ("finger", "organ")
    assert message.header.stamp.sec == 1
    got = contact_from_msg(message)
    for name in ("reference", "wrench", "stiffness", "damping"):
        np.testing.assert_array_equal(getattr(got, name), getattr(sent, name))
    assert (got.valid_for, got.reach, got.contact) == (0.1, 0.01, True)


def test_what_is_not_finite_is_refused() -> None:
    message = contact_to_msg(model(), "finger", "organ", conversions.stamp_of(0))
    message.stiffness[7] = np.nan
    with pytest.raises(ValueError, match="contact model of finger is not finite"):
        contact_from_msg(message)
    message = contact_to_msg(model(), "finger", "organ", conversions.stamp_of(0))
    message.reference.orientation.w = 5.0
    with pytest.raises(ValueError, match="allowed: 1 within"):
        contact_from_msg(message)
