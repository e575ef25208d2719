"""Pictures of the repair of an atrial septal defect, from a session's bag.

`python3 -m viz_bridge.repair_pictures BAG FOLDER` draws them.
"""

from __future__ import annotations

import argparse
import copy
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viz_bridge.bag_reader import read_organ
from viz_bridge.cdr import Message
from viz_bridge.moments import Moment, lips, opening
from viz_bridge.organ_follower import OrganFollower
from viz_bridge.organ_surface import OrganSurface, surface_of
from viz_bridge.picture_scene import Camera, arrays_of, handle_direction, tool_outline
from viz_bridge.pictures import Pictures, render_files

AXIS = np.array([-0.3843, 0.9224, 0.0384])
"""Along the hole, from the right to the left atrium."""

PLACE = np.array([-3.2e-3, -14.5e-3, 11.8e-3])
"""What is looked at [m]: on that line, between the wall of the right atrium and the hole."""

FAR, NEAR = 0.155, 0.085
"""Distances of the camera from there [m]."""

IN_USE = 0.025
"""Tools farther from there are put aside and not drawn [m]."""


TOPICS = ("tissue/topology", "tissue/edits", "tissue/state", "tissue/tools", "tissue/journal")


@dataclass(frozen=True)
class Wanted:
    """A picture.

    Attributes:
        name: Of its file.
        caption: What is to be seen; {opening} is how far the edges of the cut are apart [mm].
        edits: Edits there have been.
        seconds: How long after the last of them at most [s]; infinite: just before the next.
        away: Distance of the camera [m].
    """

    name: str
    caption: str
    edits: int
    seconds: float
    away: float


LAST = float("inf")
WANTED = (
    Wanted("asd_taut", "Two hooks make the wall of the right atrium taut", 0, LAST, FAR),
    Wanted("asd_window", "Open by {opening:.0f} mm: the defect is in view", 1, LAST, NEAR),
    Wanted("asd_patch", "A patch is carried in", 2, 2.9, NEAR),
    Wanted("asd_sewn", "Sewn over the defect, and let go", 4, 2.2, NEAR),
    Wanted("asd_thread", "The edges are brought together and sewn", 5, LAST, NEAR),
    Wanted("asd_closed", "Tightened and released", 6, LAST, FAR),
)
"""Edits are, in turn: the cut, the patch, its stitches, their tightening, the atrium's, theirs."""


class _Finder:
    """Keeps the newest state that fits each picture."""

    def __init__(self) -> None:
        self.found: dict[str, Moment] = {}
        self._organ = OrganFollower()
        self._surfaces: dict[int, OrganSurface] = {}
        self._edits = 0
        self._edited_at = 0.0

    def take(self, topic: str, message: Message) -> None:
        """Take one message."""
        organ = self._organ
        if topic == "tissue/tools":
            organ.tools.take_list(message)
        elif topic == "tissue/journal":
            organ.take_journal(message)
        elif topic == "tissue/topology":
            organ.take_topology(message)
        elif topic == "tissue/edits":
            if organ.take_edit(message):
                self._edits, self._edited_at = self._edits + 1, organ.sim_time
        elif topic == "tissue/state":
            positions = organ.take_state(message)
            if positions is not None:
                self._keep(positions)

    def _keep(self, positions: NDArray[np.float32]) -> None:
        organ, mesh = self._organ, self._organ.mesh
        if mesh is None:
            return
        for wanted in WANTED:
            late = organ.sim_time - self._edited_at > wanted.seconds
            if wanted.edits != self._edits or late:
                continue
            if mesh.version not in self._surfaces:
                self._surfaces[mesh.version] = surface_of(mesh)
            apart = 1e3 * opening(positions, *lips(mesh))
            self.found[wanted.name] = Moment(
                wanted.name, wanted.caption.format(opening=apart), organ.sim_time, organ.frame,
                self._surfaces[mesh.version], positions.copy(),
                tuple(copy.deepcopy(tool) for tool in organ.tools.by_id.values()), PLACE,
                positions[mesh.sutures.nodes],
            )  # fmt: skip


def _arrays(moment: Moment, wanted: Wanted) -> dict[str, NDArray[np.generic]]:
    """What a picture shows; shafts of tools come from their own side, not across the wound."""
    up = np.array([0.0, 0.0, 1.0])
    camera = Camera(PLACE - wanted.away * AXIS, PLACE, up)
    tools = [tool for tool in moment.tools if np.linalg.norm(tool.tip - PLACE) < IN_USE]
    arrays = arrays_of(replace(moment, tools=tuple(tools)), camera)
    handle, right = handle_direction(camera), np.cross(up, -AXIS)
    right /= np.linalg.norm(right)
    mirrored = handle - 2.0 * (handle @ right) * right
    for number, tool in enumerate(tool for tool in tools if tool.state != "free"):
        on_the_left = (tool.tip - PLACE) @ right < -0.001
        arrays[f"tool{number}"] = tool_outline(tool, mirrored if on_the_left else handle)
    return arrays


def arrays_from(bag: Path) -> dict[str, dict[str, NDArray[np.generic]]]:
    """What the pictures of `WANTED` show, by name, those that a bag has.

    Args:
        bag: Of a session that played asd_repair.yaml; directory or file.

    Raises:
        ValueError: The bag cannot be read.
    """
    finder = _Finder()
    for topic, item in read_organ(bag, None):
        if topic in TOPICS:
            finder.take(topic, item.message)
    return {
        wanted.name: _arrays(finder.found[wanted.name], wanted)
        for wanted in WANTED
        if wanted.name in finder.found
    }


def draw_repair(bag: Path, folder: Path) -> Pictures:
    """Draw them; see `arrays_from`.

    Args:
        bag: Directory or file.
        folder: Where the PNG files go.
    """
    return render_files(arrays_from(bag), folder)


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="python3 -m viz_bridge.repair_pictures", description=__doc__.splitlines()[0]
    )
    parser.add_argument("bag", type=Path, help="of a session that played asd_repair.yaml")
    parser.add_argument("folder", type=Path, help="where the PNG files go")
    given = parser.parse_args(args)
    try:
        pictures = draw_repair(given.bag, given.folder)
    except ValueError as error:
        parser.error(str(error))
    for file in pictures.files:
        print(file)
    if pictures.message:
        print(pictures.message)
    return 0 if len(pictures.files) == len(WANTED) else 1


if __name__ == "__main__":
    sys.exit(main())
