"""Declaring read-only parameters with a description and a range, and refusing misspelt ones."""

from __future__ import annotations

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

GIVEN_BY_ROS = ("use_sim_time", "start_type_description_service")


def declare_text(node: Node, name: str, default: str, description: str) -> str:
    """Declare a read-only text and return its value."""
    descriptor = ParameterDescriptor(description=description, read_only=True)
    return str(_declare(node, name, default, descriptor))


def declare_number(
    node: Node, name: str, default: float, low: float, high: float, description: str
) -> float:
    """Declare a read-only number with its range and return its value."""
    descriptor = ParameterDescriptor(
        description=description,
        read_only=True,
        floating_point_range=[FloatingPointRange(from_value=low, to_value=high, step=0.0)],
    )
    return float(_declare(node, name, float(default), descriptor))


def declare_flag(node: Node, name: str, default: bool, description: str) -> bool:
    """Declare a read-only flag and return its value."""
    return bool(
        _declare(node, name, default, ParameterDescriptor(description=description, read_only=True))
    )


def _declare(
    node: Node, name: str, default: str | float | bool, descriptor: ParameterDescriptor
) -> str | float | bool:
    try:
        return node.declare_parameter(name, default, descriptor).value
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        raise ValueError(f"parameter {name} ({descriptor.description}): {error}") from None


def refuse_unknown(node: Node) -> None:
    """Refuse parameters that were given and that nobody has declared.

    Raises:
        ValueError: There is one, such as a misspelt key of a parameter file.
    """
    given = node._parameter_overrides
    unknown = [name for name in given if not node.has_parameter(name)]
    if unknown:
        known = sorted(node.get_parameters_by_prefix("").keys())
        known = [name for name in known if name not in GIVEN_BY_ROS]
        raise ValueError(
            f"unknown parameter {', '.join(sorted(unknown))}; known: {', '.join(known)}"
        )
