"""One window of the operating table: what a person sees there, and what their drags do."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from tool_input.table.blade_mode import BladeMode
from tool_input.table.cut_mode import CutMode
from tool_input.table.drag_input import DEPTH_MODIFIER, DragInput
from tool_input.table.grab_mode import GrabMode
from tool_input.table.hand_mode import HandMode
from tool_input.table.help_panel import add_help, help_text
from tool_input.table.model_panel import ModelPanel
from tool_input.table.modes import Drag, Mode, ModeMaker
from tool_input.table.organ_view import OrganView
from tool_input.table.page_scene import PageScene, Placement
from tool_input.table.panel import Panel
from tool_input.table.patch_mode import PatchMode
from tool_input.table.person import Person
from tool_input.table.playback_panel import PlaybackPanel
from tool_input.table.pointer import Eye
from tool_input.table.probe_mode import ProbeMode
from tool_input.table.readout import Readout
from tool_input.table.risk_dots import RiskDots
from tool_input.table.risk_mode import RiskMode
from tool_input.table.seam_lines import SeamLines
from tool_input.table.sew_mode import SewMode
from tool_input.table.tissue_frame import TissueFrame
from tool_input.table.tools_view import ToolsView
from tool_input.table.view_panel import ViewPanel
from tool_input.table.views import VIEWS

MODES: tuple[ModeMaker, ...] = (
    GrabMode, ProbeMode, CutMode, BladeMode, SewMode, PatchMode, RiskMode, HandMode,
)  # fmt: skip
"""What a person can do by dragging; the first is chosen when a window opens."""


class Window:
    """What one person sees and does. All of it is called in the node's thread.

    Attributes:
        person: Who looks at it.
    """

    def __init__(self, client: viser.ClientHandle, person: Person) -> None:
        """Open a window.

        Args:
            client: viser's side of it.
            person: Who looks at it.
        """
        self.person = person
        self._client = client
        watches = ", you only watch" if person.observer else ""
        client.gui.add_markdown(f"You are **{person.name}**{watches}")
        self._told: list[Readout | ModelPanel | PlaybackPanel] = [Readout(person.desk, client.gui)]
        self._scene = PageScene(client.scene, Placement(np.zeros(3), 1.0))
        self._epoch = b""
        self._drags = DragInput(self._scene, self._dragged)
        self._organ: OrganView | None = None
        self._view: ViewPanel | None = None
        self._tools = ToolsView(self._scene, person.name)
        self._seams = SeamLines(self._scene)
        self._risks = RiskDots(self._scene)
        self._modes: dict[str, Mode] = {}
        self._mode: Mode | None = None
        self._folder: viser.GuiFolderHandle | None = None
        self._settings_order = 0.0

    def draw(self, frame: TissueFrame) -> None:
        """Show the tissue at one frame."""
        if frame.epoch != self._epoch:
            self._place(frame)
        assert self._organ is not None
        assert self._view is not None
        with self._client.atomic():
            self._organ.show(frame)
            self._tools.show(frame)
            self._seams.show(frame)
            self._risks.show(frame)
        self._view.show(frame)
        for panel in self._told:
            panel.update()
        self._drags.see(frame)
        self._drags.expire()

    def choose(self, name: str) -> None:
        """Choose a mode by its name, unless it is chosen already."""
        if self._mode is self._modes[name]:
            return
        self._drags.forget()
        if self._mode is not None:
            self._mode.leave()
        if self._folder is not None:
            self._folder.remove()
        self._mode = self._modes[name]
        self._folder = self._client.gui.add_folder(name.capitalize(), order=self._settings_order)
        with self._folder:
            self._client.gui.add_markdown(self._mode.help)
            self._mode.settings(self._client.gui)

    def close(self) -> None:
        """The window is gone: what its person holds is let go, and their tools go."""
        self._drags.forget()
        try:
            if self._mode is not None:
                self._mode.leave()
        finally:
            self.person.leave()

    def _place(self, frame: TissueFrame) -> None:
        """Another organ, or the same from its start."""
        mesh = frame.mesh
        self._scene.placement = Placement.around(mesh.rest[: mesh.node_rows])
        if self._epoch:
            self._drags.forget()
            self.person.tools.make_again()
        else:
            self._organ = OrganView(self._scene, self._listen)
            self._view = ViewPanel(self.person, self._client.gui, self._organ)
            if not self.person.observer:
                self._add_modes()
                self._add_panels()
        self._epoch = frame.epoch

    def _add_modes(self) -> None:
        gui = self._client.gui
        self._modes = {
            mode.name: mode for mode in (make(self.person, self._scene) for make in MODES)
        }
        buttons = gui.add_button_group("Mode", tuple(self._modes))
        self._settings_order = buttons.order + 0.5
        buttons.on_click(self.person.in_turn(lambda: self.choose(buttons.value)))
        for mode in self._modes.values():
            command = gui.add_command(mode.name, description=mode.help, hotkey=mode.key)
            command.on_trigger(self.person.in_turn(lambda name=mode.name: self.choose(name)))
        self.choose(next(iter(self._modes)))

    def _add_panels(self) -> None:
        gui = self._client.gui
        panel = Panel(self.person, gui)
        self._told += [PlaybackPanel(self.person, gui), ModelPanel(self.person, gui)]
        add_help(gui, help_text(self._modes.values(), VIEWS.values(), panel.commands))

    def _listen(self, mesh: viser.MeshHandle) -> None:
        """Take drags on a mesh that shows tissue."""
        if not self.person.observer:
            mesh.on_drag("left")(self._on_drag)
            mesh.on_drag("left", modifier=DEPTH_MODIFIER)(self._on_drag)

    async def _on_drag(self, event: Any) -> None:
        camera = event.client.camera
        w, x, y, z = camera.wxyz
        axes = Rotation.from_quat([x, y, z, w]).as_matrix()
        eye = Eye(self._scene.to_organ(camera.position), axes[:, 2], -axes[:, 1])
        self.person.desk.soon(lambda: self.person.attempt(self._drags.take, event, eye))

    def _dragged(self, drag: Drag) -> None:
        if self._mode is not None:
            self._mode.drag(drag)
