"""Tools played to an organ in one process: what decides which tissue they hold, and where it is."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable

from tissue_sim.compare.organ import Organ
from tissue_sim.compare.organs import SceneValues
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.scene_geometry import suggest_interaction
from tissue_sim.interaction.tools import GRAB, SPHERE, ToolSpec
from tissue_sim.scene import Scene
from tissue_sim.scene_file import find_scene, scene_names

STEPS = 40
"""Steps in a frame of the model that decides where tissue is when it is grabbed."""

LEAST_HZ = 60.0
"""Tools are moved at least so often [1/s]."""

ORGAN_FRAME = "organ"


def tools_beside(organ: Organ) -> dict[str, ToolSpec]:
    """Tools by name that the project's scene of this name has; none if there is no such scene."""
    if organ.name not in scene_names():
        return {}
    settings = SceneValues.of(find_scene(organ.name)).settings
    return {tool.id: tool for tool in settings.scene.tools}


def grasper(name: str, organ: Organ) -> ToolSpec:
    """A tool for an organ that nobody has chosen one for."""
    radius = suggest_interaction(organ.mesh).radius
    return ToolSpec(name, GRAB, SPHERE, (radius,)).checked()


def deciding_model(organ: Organ) -> str:
    """The model that decides where tissue is when it is grabbed.

    Linear finite elements, which are at equilibrium after few steps; on a sheet, which they do not
    know, LR.
    """
    return "finite_element" if organ.mesh.sheet is None else "lr"


def session_hz(rate_hz: float) -> float:
    """The multiple of a rate at which tools are moved [1/s]."""
    return rate_hz * math.ceil(LEAST_HZ / rate_hz)


def stage_of(organ: Organ, tools: Iterable[ToolSpec], rate_hz: float) -> tuple[Mesh, Scene]:
    """A copy of an organ's mesh, and a scene in which tools grab it by position or by force."""
    grabs = tuple(tool for tool in tools if tool.kind == GRAB)
    scene = Scene(
        deciding_model(organ), material=organ.material, tools=grabs, rate_hz=session_hz(rate_hz)
    )
    return copy.deepcopy(organ.mesh), scene


def frame_note(frames: Iterable[str]) -> tuple[str, ...]:
    """What people should know of poses that are not said to be in the organ's frame."""
    others = sorted({frame for frame in frames if frame not in ("", ORGAN_FRAME)})
    if not others:
        return ()
    return (f"poses in frame {', '.join(others)} are taken as if in frame {ORGAN_FRAME}",)
