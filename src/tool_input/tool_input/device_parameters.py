"""Parameters that the nodes of all devices share."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from tissue_sim.parameters import ParameterError, Spec

WORKSPACE = (
    Spec(
        "workspace_min",
        "doubles",
        [-1.0, -1.0, -1.0],
        "lowest corner of where the tool may be, in the frame of the organ",
        "m",
        -100.0,
        100.0,
        length=3,
    ),
    Spec(
        "workspace_max",
        "doubles",
        [1.0, 1.0, 1.0],
        "highest corner of where the tool may be, in the frame of the organ",
        "m",
        -100.0,
        100.0,
        length=3,
    ),
)
INPUT_TIMEOUT = Spec(
    "input_timeout", "double", 0.5, "silence after which the device is unplugged", "s", 0.05, 60.0
)


def unit_quaternion(name: str, values: list[float]) -> Rotation:
    """A rotation from a parameter that is a quaternion x y z w.

    Raises:
        ParameterError: Its length is not 1.
    """
    if abs(np.linalg.norm(values) - 1.0) > 0.01:
        raise ParameterError(
            f"{name} = {values} is not allowed; allowed: a quaternion x y z w of length 1"
        )
    return Rotation.from_quat(values)
