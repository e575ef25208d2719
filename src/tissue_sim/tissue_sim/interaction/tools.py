"""Tools: abstract instruments that act on tissue while they are used."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.interaction import rigid
from tissue_sim.interaction.contact import Contact
from tissue_sim.interaction.coupling import HOLDS, POSITION, Coupling
from tissue_sim.interaction.cut_response import CutResponse

GRAB, CUT, BURN, PATCH, PROBE = "grab", "cut", "burn", "patch", "probe"
AT_USE, PROGRESSIVE = "at_use", "progressive"
CUTTING = (AT_USE, PROGRESSIVE)
"""How a blade cuts: once, where it is pressed, or all it passes while it is pressed."""
SPHERE, BOX, CAPSULE = "sphere", "box", "capsule"
RECTANGLE, TRIANGLE = "rectangle", "triangle"
SHAPES = {
    GRAB: (SPHERE, BOX, CAPSULE),
    CUT: (RECTANGLE, TRIANGLE),
    BURN: (SPHERE,),
    PATCH: (RECTANGLE,),
    PROBE: (SPHERE, CAPSULE),
}
SIZE_WORDS = {
    SPHERE: "[radius]",
    BOX: "[length along x, along y, along z]",
    CAPSULE: "[radius, length along z]",
    RECTANGLE: "[length along x, depth along z]",
    TRIANGLE: "[length along x at the top, depth along z]",
}
SIZE_COUNT = {SPHERE: 1, BOX: 3, CAPSULE: 2, RECTANGLE: 2, TRIANGLE: 2}
SMALLEST, LARGEST = 1e-6, 10.0
"""Allowed lengths of a tool [m]."""

_ID = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")


class ToolError(ValueError):
    """A tool that is not allowed."""


@dataclass(frozen=True)
class ToolSpec:
    """What a tool is.

    Attributes:
        id: The <tool> in tools/<tool>/servo_cp.
        kind: grab, cut, burn, patch or probe.
        shape: See `SHAPES`.
        size: Its lengths [m], see `SIZE_WORDS`.
        pose: Where it is before a pose is received, in the organ frame: x y z [m] and quaternion.
        owner: Who set it.
        scale: Metres the tip moves per metre of its source.
        offset: Added to the source's position, after scaling [m].
        hold: How a grab holds: "position" puts nodes where the tool is, "force" pulls them there.
        coupling: What a hold by force pulls with.
        cutting: How a blade cuts: "at_use" or "progressive".
        response: What tissue does to a blade that cuts progressively.
        contact: What a probe presses with.
    """

    id: str
    kind: str = GRAB
    shape: str = SPHERE
    size: tuple[float, ...] = (0.005,)
    pose: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    owner: str = "scene"
    scale: float = 1.0
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)
    hold: str = POSITION
    coupling: Coupling = field(default_factory=Coupling)
    cutting: str = AT_USE
    response: CutResponse = field(default_factory=CutResponse)
    contact: Contact = field(default_factory=Contact)

    def checked(self) -> ToolSpec:
        """This tool with its quaternion normalised, if it is allowed.

        Raises:
            ToolError: Naming what is wrong and what is allowed.
        """
        if not _ID.match(self.id):
            raise ToolError(
                f"tool id {self.id!r} is not allowed; allowed: a letter, then letters, digits and _"
            )
        if self.kind not in SHAPES:
            raise ToolError(self._allowed("kind", self.kind, ", ".join(SHAPES)))
        if self.shape not in SHAPES[self.kind]:
            allowed = f"{', '.join(SHAPES[self.kind])} for kind {self.kind}"
            raise ToolError(self._allowed("shape", self.shape, allowed))
        in_range = all(SMALLEST <= length <= LARGEST for length in self.size)
        if len(self.size) != SIZE_COUNT[self.shape] or not in_range:
            allowed = f"{SIZE_WORDS[self.shape]} with lengths from {SMALLEST:g} to {LARGEST:g} m"
            raise ToolError(self._allowed("size", list(self.size), allowed))
        if not 1e-3 <= self.scale <= 1e3:
            raise ToolError(self._allowed("scale", self.scale, "0.001 to 1000"))
        if len(self.offset) != 3 or not all(math.isfinite(value) for value in self.offset):
            raise ToolError(self._allowed("offset", list(self.offset), "three finite numbers [m]"))
        if self.hold not in HOLDS:
            raise ToolError(self._allowed("hold", self.hold, ", ".join(HOLDS)))
        if self.cutting not in CUTTING:
            raise ToolError(self._allowed("cutting", self.cutting, ", ".join(CUTTING)))
        if self.cutting == PROGRESSIVE and self.kind != CUT:
            raise ToolError(self._allowed("cutting", self.cutting, f"{AT_USE} for kind {GRAB}"))
        try:
            self.coupling.checked()
            self.response.checked()
            self.contact.checked()
        except ValueError as error:
            raise ToolError(f"tool {self.id}: {error}") from None
        if len(self.pose) != 7:
            raise ToolError(self._allowed("pose", list(self.pose), "x y z and a quaternion"))
        try:
            pose = rigid.checked_pose(np.array(self.pose))
        except rigid.PoseError as error:
            raise ToolError(f"tool {self.id}: {error}") from None
        return replace(self, pose=tuple(pose.tolist()))

    def _allowed(self, what: str, value: object, allowed: str) -> str:
        return f"tool {self.id}: {what} {value!r} is not allowed; allowed: {allowed}"

    def as_arguments(self) -> dict[str, Any]:
        """This tool as arguments of a `set_tool` command; plain JSON values."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        values["coupling"] = self.coupling.as_arguments()
        values["response"] = self.response.as_arguments()
        values["contact"] = self.contact.as_arguments()
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in values.items()
        }

    @classmethod
    def from_arguments(cls, arguments: Mapping[str, Any]) -> ToolSpec:
        """A checked tool from the arguments of a `set_tool` command.

        Raises:
            ToolError: Naming what is wrong and what is allowed.
        """
        known = {**arguments}
        for name in ("size", "pose", "offset"):
            if name in known:
                known[name] = tuple(float(value) for value in known[name])
        try:
            if "coupling" in known:
                known["coupling"] = Coupling.from_arguments(known["coupling"])
            if "response" in known:
                known["response"] = CutResponse.from_arguments(known["response"])
            if "contact" in known:
                known["contact"] = Contact.from_arguments(known["contact"])
        except ValueError as error:
            raise ToolError(f"tool {known.get('id', '')}: {error}") from None
        try:
            return cls(**known).checked()
        except TypeError as error:
            raise ToolError(f"tool: {error}") from None


def blade(
    spec: ToolSpec, pose: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """The sweep of a cutting tool's blade.

    Args:
        spec: A tool of kind cut.
        pose: Its pose in the organ frame, shape (7,).

    Returns:
        Corners [m], shape (n, 3), and corner rows of the triangles, shape (m, 3).
    """
    corners = outline(spec)
    later = np.arange(1, len(corners) - 1)
    triangles = np.stack([np.zeros_like(later), later, later + 1], axis=1)
    return rigid.to_world(pose, corners), triangles.astype(np.uint32)


def outline(spec: ToolSpec) -> NDArray[np.float64]:
    """Corners of a blade or of a patch in the tool's axes [m], in its xz plane, shape (n, 3).

    They go round from x to z, so that the side k from corner k to the next has its outside to the
    right.
    """
    half, depth = spec.size[0] / 2, spec.size[1]
    if spec.shape == TRIANGLE:
        return np.array([[0.0, 0.0, 0.0], [half, 0.0, depth], [-half, 0.0, depth]])
    low, high = -depth / 2, depth / 2
    return np.array([[-half, 0, low], [half, 0, low], [half, 0, high], [-half, 0, high]])
