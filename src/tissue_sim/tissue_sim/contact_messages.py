"""Contact models as messages, and back."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from tissue_interfaces.msg import ContactModel as ContactModelMsg

from tissue_sim import conversions
from tissue_sim.interaction import rigid
from tissue_sim.interaction.contact_model import ContactModel


def contact_to_msg(model: ContactModel, tool: str, frame_id: str, stamp: Time) -> ContactModelMsg:
    """A contact model as a message.

    Args:
        model: The model.
        tool: Id of the tool.
        frame_id: The organ's frame.
        stamp: Start of the frame it was found in.
    """
    message = ContactModelMsg(
        header=conversions.header(frame_id, stamp),
        tool=tool,
        reference=conversions.pose_message(model.reference),
        wrench=conversions.wrench_message(model.wrench),
        valid_for=model.valid_for,
        reach=model.reach,
        contact=model.contact,
    )
    message.stiffness = model.stiffness.reshape(-1)
    message.damping = model.damping.reshape(-1)
    return message


def contact_from_msg(message: ContactModelMsg) -> ContactModel:
    """A contact model from a message.

    Raises:
        ValueError: A number is not finite, or the pose cannot be used.
    """
    force, torque = message.wrench.force, message.wrench.torque
    model = ContactModel(
        rigid.checked_pose(conversions.pose_array(message.reference)),
        np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z]),
        conversions.array_of(message.stiffness, np.float64).reshape(6, 6),
        conversions.array_of(message.damping, np.float64).reshape(6, 6),
        float(message.valid_for),
        float(message.reach),
        bool(message.contact),
    )
    numbers = (model.wrench, model.stiffness, model.damping, [model.valid_for, model.reach])
    if not all(np.isfinite(values).all() for values in numbers):
        raise ValueError(f"the contact model of {message.tool} is not finite")
    return model
