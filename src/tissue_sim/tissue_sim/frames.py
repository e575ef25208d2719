"""Static coordinate frames from parameters: `frames.<name>.parent`, `.translation`, `.rotation`.

A pose in frame `<name>` is turned into the organ's frame along the tree of parents; the organ's
frame may itself be a child of another one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.interaction import rigid
from tissue_sim.parameters import Spec

PREFIX = "frames"


class UnknownFrameError(ValueError):
    """A frame that has no known way to the organ's frame."""


@dataclass(frozen=True)
class StaticFrame:
    """Where a frame lies in its parent.

    Attributes:
        name: Its frame_id.
        parent: frame_id of the parent.
        pose: Its origin [m] and orientation (quaternion x y z w) in the parent, shape (7,).
    """

    name: str
    parent: str
    pose: NDArray[np.float64]


def frame_specs(names: Iterable[str]) -> list[Spec]:
    """Parameters of the static frames with these names."""
    specs = []
    for name in names:
        base = f"{PREFIX}.{name}"
        specs += [
            Spec(f"{base}.parent", "string", "", f"Frame that {name} is given in."),
            Spec(
                f"{base}.translation", "doubles", [0.0, 0.0, 0.0],
                f"Origin of {name} in its parent.", unit="m", length=3,
            ),
            Spec(
                f"{base}.rotation", "doubles", [0.0, 0.0, 0.0, 1.0],
                f"Orientation of {name} in its parent, quaternion x y z w.", length=4,
            ),
        ]  # fmt: skip
    return specs


class Frames:
    """The tree of static frames about an organ."""

    def __init__(self, organ: str, frames: Iterable[StaticFrame] = ()) -> None:
        """Check and keep the tree.

        Args:
            organ: frame_id of the organ.
            frames: The static frames.

        Raises:
            ValueError: A frame has no parent, a pose is not allowed, or parents go in a circle.
        """
        self.organ = organ
        self._frames = {frame.name: frame for frame in frames}
        for frame in self._frames.values():
            if not frame.parent:
                raise ValueError(f"{PREFIX}.{frame.name}.parent is missing")
            self._refuse_circle(frame.name)
        root, organ_pose = self._to_root(organ)
        back = rigid.inverse(organ_pose)
        self._to_organ: dict[str, NDArray[np.float64]] = {}
        names = {organ, root, *self._frames, *(f.parent for f in self._frames.values())}
        for name in sorted(names):
            frame_root, pose = self._to_root(name)
            if frame_root == root:
                self._to_organ[name] = rigid.compose(back, pose)

    @classmethod
    def from_parameters(cls, organ: str, values: Mapping[str, Any]) -> Frames:
        """Frames from checked parameter values by full name (see `frame_specs`)."""
        suffix = ".parent"
        names = [
            key[len(PREFIX) + 1 : -len(suffix)]
            for key in values
            if key.startswith(PREFIX + ".") and key.endswith(suffix)
        ]
        frames = []
        for name in names:
            base = f"{PREFIX}.{name}"
            numbers = [*values[f"{base}.translation"], *values[f"{base}.rotation"]]
            try:
                pose = rigid.checked_pose(np.array(numbers))
            except rigid.PoseError as error:
                raise ValueError(f"{base}: {error}") from None
            frames.append(StaticFrame(name, values[f"{base}.parent"], pose))
        return cls(organ, frames)

    @property
    def known(self) -> list[str]:
        """Frames that poses may be given in."""
        return sorted(self._to_organ)

    def pose_in_organ(self, frame_id: str, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """A pose given in `frame_id`, in the organ's frame, shape (7,).

        Raises:
            UnknownFrameError: The frame is unknown; the message names those that are known.
        """
        if frame_id == self.organ:
            return pose
        return rigid.compose(self._pose_of(frame_id), pose)

    def points_in_organ(self, frame_id: str, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points [m] given in `frame_id`, in the organ's frame, shape (n, 3).

        Raises:
            UnknownFrameError: The frame is unknown; the message names those that are known.
        """
        if frame_id == self.organ:
            return points
        return rigid.to_world(self._pose_of(frame_id), points)

    def _pose_of(self, frame_id: str) -> NDArray[np.float64]:
        pose = self._to_organ.get(frame_id)
        if pose is not None:
            return pose
        known = ", ".join(self.known)
        if not frame_id:
            raise UnknownFrameError(f"header.frame_id is empty; known frames: {known}")
        raise UnknownFrameError(
            f"unknown frame '{frame_id}'; known frames: {known}. To make it known, "
            f"add to the scene file under ros__parameters:\n"
            f"  {PREFIX}.{frame_id}.parent: {self.organ}\n"
            f"  {PREFIX}.{frame_id}.translation: [0.0, 0.0, 0.0]\n"
            f"  {PREFIX}.{frame_id}.rotation: [0.0, 0.0, 0.0, 1.0]"
        )

    def _refuse_circle(self, name: str) -> None:
        seen = [name]
        while seen[-1] in self._frames:
            parent = self._frames[seen[-1]].parent
            if parent in seen:
                raise ValueError(f"frames go in a circle: {' -> '.join([*seen, parent])}")
            seen.append(parent)

    def _to_root(self, name: str) -> tuple[str, NDArray[np.float64]]:
        pose = rigid.IDENTITY
        while name in self._frames:
            frame = self._frames[name]
            pose = rigid.compose(frame.pose, pose)
            name = frame.parent
        return name, pose
