"""The simulation: mesh, state, model, tools and holds, advanced frame by frame."""

from __future__ import annotations

import os
import time
import zlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.commands import execute
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Model, State
from tissue_sim.elastic.predictor import predictor_of
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.frame import (
    Answer,
    AppliedEdit,
    Budget,
    Command,
    Cut,
    Frame,
    FrameInputs,
    JournalEntry,
    ToolSample,
)
from tissue_sim.geometry.edit import EditChange, EditError, StaleEditError, TopologyEdit
from tissue_sim.geometry.edit_check import CheckedEdit
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sutures import tensions
from tissue_sim.interaction.coupling import FORCE
from tissue_sim.interaction.holds import Hold, Holds
from tissue_sim.interaction.patch import Patch
from tissue_sim.interaction.probes import Probes
from tissue_sim.interaction.reach import nodes_in_sphere, nodes_inside
from tissue_sim.interaction.reaction import NOTHING, wrench_on_tool
from tissue_sim.interaction.seeding import Seeding
from tissue_sim.interaction.tools import AT_USE, CUT, GRAB, PATCH, PROBE, ToolSpec, blade
from tissue_sim.kept_state import KeptState
from tissue_sim.progressive import ProgressiveCuts
from tissue_sim.scene import Scene

LONGER = 1.25
"""A step may take so many times as long as the longest one of its frame."""


class Simulation:
    """One epoch of one organ. `advance` is the only way time passes.

    What `advance` does depends on its inputs and on the number of steps only: the journal that the
    frames carry is enough to repeat it bit by bit.

    Attributes:
        mesh, state, model: The organ, its shape and how it deforms.
        model_parameters: Parameters of the model that differ from its defaults.
        scene: What it started with.
        epoch: Id of the epoch, 16 bytes.
        frame: Number of the last frame; 0 before the first.
        sim_time: Simulated time [s].
        paused: Whether time stands still.
        tools: Tools by id.
        poses: Pose of every tool as used last, shape (7,) each.
        holds: What the tools hold.
        blades: What the tools that cut as they move have passed.
        probes: What the tools that probe touch.
        history: The edits made, to undo and redo them.
        lost_states: Frames whose state was not finite or exploded, and was restored.
    """

    def __init__(self, mesh: Mesh, scene: Scene | None = None, epoch: bytes | None = None) -> None:
        """Build the model and stand at frame 0.

        Args:
            mesh: The organ; the simulation changes it in place.
            scene: Model, material, tools and rate; None for the defaults.
            epoch: Id of the epoch; None for a new one.

        Raises:
            ValueError: A model, a parameter or a tool is not allowed.
        """
        self.scene = scene or Scene()
        if not 1.0 <= self.scene.rate_hz <= 1000.0:
            raise ValueError(f"rate_hz = {self.scene.rate_hz:g} is not allowed; allowed: 1 to 1000")
        self.mesh = mesh
        self._exchange_fibres()
        self.epoch = epoch or os.urandom(16)
        self.state = State(mesh)
        if self.scene.displacement is not None:
            rows = mesh.node_rows
            self.state.displacement[:rows] = self.scene.displacement
            self.state.previous[:rows] = self.scene.displacement
        self._seeding = Seeding(mesh, self.scene.seeded_release)
        self._unseeded: list[NDArray[np.int32]] = []
        self.tools: dict[str, ToolSpec] = {}
        self._pressed: dict[str, bool] = {}
        self.poses: dict[str, NDArray[np.float64]] = {}
        self.holds = Holds(mesh)
        self.blades = ProgressiveCuts(self)
        self.probes = Probes(mesh)
        for tool in self.scene.tools:
            self.set_tool(tool.checked())
        self.frame, self.sim_time, self.lost_states = 0, 0.0, 0
        self.paused = False
        self.model: Model = self.build_model(self.scene.model, {})
        self.model_parameters = dict(self.scene.parameters.get(self.scene.model, {}))
        self.model.prescribed_changed(self.state, self._moved_by_tools)
        self._seeding.warm_up(self._network)
        predictor = self.scene.predictor
        self._predictor = predictor_of(
            predictor, self.scene.predictor_steps, self.model, self._network,
            self.scene.parameters.get(predictor, {}), self.state,
        )  # fmt: skip
        self._prepared: dict[str, tuple[int, Model]] = {}
        self._checked: dict[int, CheckedEdit] = {}
        self._kept = KeptState(mesh, self.state)
        self._owed = 0.0
        self._tools_changed = True
        self._events: list[str] = []
        self.history = EditHistory()
        self._brought_back: list[AppliedEdit] = []

    def _exchange_fibres(self) -> None:
        """The mesh's fibres into the scene, for the journal; or a journal's into the mesh."""
        rows, given = self.mesh.element_rows, self.scene.fibres
        if given is not None:
            if given.shape != (rows, 3):
                raise ValueError(f"fibres have shape {given.shape}; allowed: ({rows}, 3)")
            self.mesh.fibres[:rows] = given
        elif self.mesh.fibres[:rows].any():
            self.scene = replace(self.scene, fibres=self.mesh.fibres[:rows].copy())

    # What commands do

    def grab(self, tool: str, radius: float, by_use: bool) -> Hold | None:
        """Hold the nodes inside a tool's shape; None if there is none.

        Args:
            tool: Its id.
            radius: Of a sphere around its tip to take instead [m]; 0: its own shape.
            by_use: Whether it was pressed.
        """
        wanted = self.within_reach(tool, radius, self.state.displacement)
        if not len(wanted):
            return None
        return self.hold(tool, wanted, by_use, self.tools[tool].hold == FORCE)

    def within_reach(
        self, tool: str, radius: float, displacement: NDArray[np.floating]
    ) -> NDArray[np.int32]:
        """Rows of the nodes that `grab` takes where nodes are displaced so [m], shape (n, 3)."""
        spec, pose = self.tools[tool], self.poses[tool]
        if radius > 0.0:
            return nodes_in_sphere(self.mesh, displacement, pose[:3], radius)
        return nodes_inside(self.mesh, displacement, spec, pose)

    def hold(self, tool: str, rows: NDArray[np.int32], by_use: bool, by_force: bool) -> Hold:
        """Hold some nodes, none of them fixed."""
        hold = self.holds.grab(rows, self._places(rows), tool, self.poses[tool], by_use, by_force)
        self._holds_changed()
        self._report_unfelt([hold])
        return hold

    def release(self, holds: list[Hold]) -> None:
        """Let go of holds."""
        for hold in holds:
            freed = self.holds.release(hold, self._places(hold.rows), self.poses)
            # What a tool lets go of starts from rest.
            self.state.previous[freed] = self.state.displacement[freed]
            if self._seeding.radius > 0.0:
                self._unseeded.append(freed)
        if holds:
            self._holds_changed()

    def set_tool(self, tool: ToolSpec) -> None:
        """Create a tool or change one; one that exists stays where it is."""
        if self.tools.get(tool.id, tool) != tool:
            self.blades.forget(tool.id)
        self.tools[tool.id] = tool
        self.poses.setdefault(tool.id, np.array(tool.pose))
        self._tools_changed = True

    def remove_tool(self, tool: str) -> None:
        """Remove a tool and release its holds."""
        self.blades.forget(tool)
        self.release(self.holds.of_tool(tool))
        del self.tools[tool], self.poses[tool]
        self._pressed.pop(tool, None)
        self._tools_changed = True

    def build_model(self, name: str, parameters: Mapping[str, float]) -> Model:
        """Build a model of the mesh as it is now; parameters not given keep their configured value.

        It may be called beside `advance` from another thread while no edit is applied.

        Raises:
            ValueError: The model or a parameter is not allowed.
        """
        values = {**self.scene.parameters.get(name, {}), **parameters}
        running = getattr(self, "model", None)
        springs = getattr(running, "springs", None)
        return registry.build(name, self.mesh, self.scene.material, values, springs)

    def offer_model(self, request_id: str, version: int, model: Model) -> None:
        """Hand over a model built beside the loop for the `set_model` command of this request."""
        self._prepared[request_id] = (version, model)

    def offer_check(self, checked: CheckedEdit) -> None:
        """Hand over what was found out about an edit beside the loop.

        It saves time in the frame that the edit is applied in, if none comes before it.
        """
        self._checked[id(checked.edit)] = checked

    def set_model(self, name: str, parameters: Mapping[str, float], request_id: str) -> None:
        """Go on with another model; velocities become zero."""
        version, model = self._prepared.pop(request_id, (0, self.model))
        if version != self.mesh.version or model.name != name:
            model = self.build_model(name, parameters)
        self.model = model
        self.model_parameters = {**self.scene.parameters.get(name, {}), **parameters}
        self.state.previous[:] = self.state.displacement
        self._owed = 0.0
        self.model.prescribed_changed(self.state, self._moved_by_tools)
        if self._predictor is not None and not self.model.takes_guess:
            self._events.append(f"model {name} takes no prediction: {self.scene.predictor} waits")
        self.holds.forget_stiffness()
        self._report_unfelt(list(self.holds.by_id.values()))

    def undo(self, author: str, request_id: str) -> AppliedEdit:
        """Take back the newest edit, whoever made it.

        Raises:
            NoEditError: There is none.
            EditError: It cannot be applied now; nothing was changed.
        """
        return self._bring_back(self.history.undo(self.mesh, author, request_id))

    def redo(self, author: str, request_id: str) -> AppliedEdit:
        """Make the edit again that was undone last.

        Raises:
            NoEditError: There is none.
            EditError: It cannot be applied now; nothing was changed.
        """
        return self._bring_back(self.history.redo(self.mesh, author, request_id))

    def suture_forces(self) -> NDArray[np.float64]:
        """Pull of each suture at the present shape [N], in the order of `mesh.sutures`."""
        return tensions(self.mesh.sutures, self.mesh.rest, self.state.displacement)

    def _bring_back(self, edit: TopologyEdit) -> AppliedEdit:
        applied = self._carry_out(edit)
        self._brought_back.append(applied)
        return applied

    def _report_unfelt(self, holds: list[Hold]) -> None:
        """Say which tools hold by force what has none."""
        if self.model.has_forces:
            return
        self._events += [
            f"{tool} holds by force, but {self.model.name} has no forces: the tissue follows it "
            "without pulling back, and no force is published"
            for tool in dict.fromkeys(hold.tool for hold in holds if hold.patch is not None)
        ]

    # One frame

    def advance(self, inputs: FrameInputs, budget: Budget) -> Frame:
        """Advance by one frame.

        Args:
            inputs: What takes effect in it.
            budget: How much to step.
        """
        self.frame += 1
        self._events = list(self.model.events)
        self.model.events.clear()
        self._brought_back = []
        answers = [execute(self, command) for command in inputs.commands]
        if self._unseeded and not self.paused:
            # Released while nothing might move.
            self._holds_changed()
        edits = []
        for plan in inputs.edits:
            applied, answer = self._apply(plan)
            answers.append(answer)
            edits += [applied] if applied else []
        self._remember()
        cuts = self._use_tools(inputs.tools)
        step_seconds: list[float] = []
        if not self.paused:
            self.holds.place(self.mesh, self.state.displacement, self.poses)
            self._find_contacts()
            step_seconds = self._step(budget)
            seconds = self.model.time_step
            self.sim_time += (
                1.0 / self.scene.rate_hz if seconds is None else seconds * len(step_seconds)
            )
        stepped_at = time.perf_counter()
        positions, lost = self._positions()
        accepted = replace(
            inputs,
            commands=self._with_start(inputs.commands),
            edits=tuple(edit.change.edit for edit in edits),
        )
        entry = JournalEntry(
            self.epoch, self.frame, self.mesh.version, self.sim_time, len(step_seconds), accepted,
            zlib.crc32(positions.data),
        )  # fmt: skip
        tools_changed, self._tools_changed = self._tools_changed, False
        return Frame(
            positions=positions,
            journal=entry,
            wrenches={} if self.paused or lost else self._wrenches(),
            answers=tuple(answers),
            edits=(*self._brought_back, *edits),
            cuts=cuts,
            events=tuple(self._events),
            step_seconds=np.array(step_seconds),
            stepped_at=stepped_at,
            lost=lost,
            tools_changed=tools_changed,
        )

    def _with_start(self, commands: tuple[Command, ...]) -> tuple[Command, ...]:
        if self.frame > 1:
            return commands
        return (Command("start", self.scene.as_arguments()), *commands)

    def _apply(self, plan: TopologyEdit) -> tuple[AppliedEdit | None, Answer]:
        try:
            if plan.from_history:
                raise EditError("nodes and elements are brought back by undo and redo only")
            applied = self._carry_out(plan)
        except StaleEditError as error:
            return None, Answer(plan.request_id, False, str(error), "STALE")
        except EditError as error:
            return None, Answer(plan.request_id, False, str(error), "INVALID")
        values: dict[str, Any] = {
            "applied": applied, "epoch": self.epoch, "hold_id": applied.hold
        }  # fmt: skip
        return applied, Answer(plan.request_id, True, f"version {self.mesh.version}", values=values)

    def _carry_out(self, plan: TopologyEdit) -> AppliedEdit:
        """Apply an edit, and let all that depends on the mesh follow.

        Raises:
            EditError: It cannot be applied; nothing was changed.
        """
        started = time.perf_counter()
        checked = self._checked.pop(id(plan), None)
        if checked is None or checked.version != self.mesh.version:
            checked = self.mesh.check(plan)
        if checked.applied.sews and (why := self.model.sewing_refusal()):
            raise EditError(f"model {self.model.name} refuses sutures: {why}")
        if checked.applied.added_patches and (why := self.model.patch_refusal()):
            raise EditError(f"model {self.model.name} refuses patches: {why}")
        if why := self.model.refusal(checked.nodes):
            raise EditError(f"model {self.model.name} refuses this edit: {why}")
        if plan.held_by and plan.held_by not in self.tools:
            known = ", ".join(self.tools) or "none"
            raise EditError(f"there is no tool {plan.held_by!r}; known tools: {known}")
        change = self.mesh.apply(plan, checked)
        self.history.record(change)
        self.state.follow(self.mesh, change)
        moved, merged = self._places(change.moved_nodes), self._places(change.merged_into)
        held = self.holds.rows
        emptied = self.holds.follow(self.mesh, change, moved, self.poses, merged)
        carried = self._carry(change)
        touched = change.nodes
        self.state.prescribed[touched] = self.mesh.fixed[touched] | (self.holds.owner[touched] != 0)
        self.probes.forget()
        self.model.topology_changed(change, self.state)
        if self._predictor is not None:
            self._predictor.topology_changed(change, self.state)
        self.holds.forget_stiffness()
        self._events += self.model.events
        self.model.events.clear()
        if emptied or not np.array_equal(self.holds.rows, held):
            self._holds_changed()
        self._events += [
            f"hold {h.id} of {h.tool} is released: its nodes vanished" for h in emptied
        ]
        self._events += [
            f"suture {suture} is released: a node of it vanished"
            for suture in change.released.tolist()
        ]
        return AppliedEdit(change, plan, time.perf_counter() - started, carried)

    def _carry(self, change: EditChange) -> int:
        """Let a tool hold the patch that an edit has added for it; id of the hold, 0: none."""
        edit, rows = change.edit, change.born_nodes
        if not edit.held_by or not len(rows):
            return 0
        tool = self.tools[edit.held_by]
        if tool.kind == PATCH and not self._pressed.get(tool.id, False):
            self._events.append(f"{tool.id} was released before its patch was there: it is free")
            return 0
        by_force = tool.hold == FORCE
        # Releasing `use` lets go of it as of anything that the tool holds by being used.
        hold = self.holds.grab(
            rows, self._places(rows), tool.id, self.poses[tool.id], True, by_force
        )
        self._report_unfelt([hold])
        return hold.id

    def _remember(self) -> None:
        """Keep the state from before anything moves, to go back to if it is lost."""
        self._kept.keep()
        for patch in self.holds.patches:
            patch.remember()

    def _use_tools(self, samples: tuple[ToolSample, ...]) -> tuple[Cut, ...]:
        samples = tuple(sample for sample in samples if sample.tool in self.tools)
        for sample in samples:
            self.poses[sample.tool], self._pressed[sample.tool] = sample.pose, sample.use
        cuts = self.blades.taken_over()
        for sample in samples:
            tool = self.tools[sample.tool]
            if tool.kind == CUT:
                cuts += self.blades.use(tool, sample)
            if sample.edge == -1 or (sample.edge == 1 and tool.kind == GRAB):
                self.release([h for h in self.holds.of_tool(tool.id) if h.by_use])
            if sample.edge == 1 and tool.kind == GRAB:
                if self.grab(tool.id, 0.0, by_use=True) is None:
                    self._events.append(f"{tool.id} holds nothing: no free node inside its shape")
            elif sample.edge == 1 and tool.kind == CUT and tool.cutting == AT_USE:
                cuts.append(Cut(tool.id, sample.stamp, *blade(tool, sample.pose)))
        self._events += self.blades.events
        self.blades.events.clear()
        return tuple(cuts)

    def _step(self, budget: Budget) -> list[float]:
        """Step the model until the budget is spent, at least once; seconds of each step."""
        steps = budget.steps
        if steps is None and self.model.time_step is not None:
            # The small excess keeps rounding from stealing a step when they divide evenly.
            self._owed += 1.0 / (self.scene.rate_hz * self.model.time_step) + 1e-9
            steps = int(self._owed)
            self._owed -= steps
        end = min(time.perf_counter() + budget.seconds, budget.until)
        if self._predictor is not None:
            self._predictor.predict(self.model, self.state)
        pulled, probing = self._pulled_holds(), self.probing()
        seconds: list[float] = []
        longest, last = 0.0, time.perf_counter()
        while True:
            if steps is not None and len(seconds) >= steps:
                return seconds
            for hold, patch in pulled:
                patch.advance(
                    self.poses[hold.tool], self.model, self.state, self.mesh, hold.rows, hold.local,
                    alone=len(self.holds) == 1,
                )  # fmt: skip
            if probing:
                self.probes.advance(probing, self.state, self.model, 1.0 / self.scene.rate_hz)
            self.model.step(self.state)
            now = time.perf_counter()
            seconds.append(now - last)
            longest = max(longest, now - last)
            idle = self.model.idle and not probing and all(patch.settled for _, patch in pulled)
            if steps is None and (now + LONGER * longest > end or idle):
                return seconds
            last = now

    def probing(self) -> list[tuple[ToolSpec, NDArray[np.float64]]]:
        """Probes in use, and their poses."""
        return [
            (tool, self.poses[tool.id])
            for tool in self.tools.values()
            if tool.kind == PROBE and self._pressed.get(tool.id, False)
        ]

    def _find_contacts(self) -> None:
        """Find what probes touch; the model is told when that is something else."""
        probing = self.probing()
        if not probing and not len(self.probes.rows):
            return
        if self.probes.begin(probing, self.state, self.model, self.holds.owner != 0):
            self._holds_changed()

    @property
    def _moved_by_tools(self) -> NDArray[np.int32]:
        """Rows of the nodes that tools hold or push, sorted."""
        held = self.holds.rows
        return held if not len(self.probes.rows) else np.union1d(held, self.probes.rows)

    def _pulled_holds(self) -> list[tuple[Hold, Patch]]:
        """Holds by force and their patches, ready for the steps of this frame."""
        pulled = [(hold, hold.patch) for hold in self.holds.by_id.values() if hold.patch]
        for hold, patch in pulled:
            patch.begin(
                self.tools[hold.tool].coupling, self.model.time_step or 1.0 / self.scene.rate_hz,
                self.model, self.state, self.mesh, hold.rows, hold.local,
            )  # fmt: skip
        return pulled

    def _positions(self) -> tuple[NDArray[np.float32], str]:
        """Positions after the frame, and why the state was lost; then it is restored."""
        positions, bad = self._kept.positions()
        if not bad:
            return positions, ""
        self.lost_states += 1
        lost = (
            f"{bad} nodes were not finite or farther than {self._kept.limit:g} m from rest after "
            f"frame {self.frame} with model {self.model.name}; the state before it is restored"
        )
        self._kept.restore(positions)
        for patch in self.holds.patches:
            patch.restore()
        self.probes.forget()
        # The model may remember what it made of the lost state.
        self.model.prescribed_changed(self.state, self._moved_by_tools)
        if self._predictor is not None:
            self._predictor.restart(self.state)
        return positions, lost

    def _wrenches(self) -> dict[str, NDArray[np.float64]]:
        wrenches = dict(self.blades.wrenches)
        if not self.model.has_forces:
            return wrenches
        for tool, pose in self.probing():
            wrenches[tool.id] = self.probes.wrench(tool.id, pose, self.state)
        for hold in self.holds.by_id.values():
            wrench = self.hold_wrench(hold)
            wrenches[hold.tool] = wrenches.get(hold.tool, NOTHING) + wrench
        return wrenches

    def hold_wrench(self, hold: Hold) -> NDArray[np.float64]:
        """Force [N] and torque about the tip [N m] of a hold on its tool, shape (6,)."""
        pose = self.poses[hold.tool]
        if hold.patch is not None:
            return self.tools[hold.tool].coupling.wrench_on_tool(pose, hold.patch.pose)
        forces = self.model.forces(self.state, hold.rows)
        return wrench_on_tool(forces, self._places(hold.rows), pose[:3])

    def _places(self, rows: NDArray[np.int32]) -> NDArray[np.float64]:
        places: NDArray[np.float64] = self.mesh.rest[rows] + self.state.displacement[rows]
        return places

    @property
    def _network(self) -> SpringNetwork:
        """Which nodes are neighbours; every model of a mesh keeps it up to date."""
        network: SpringNetwork = self.model.springs  # type: ignore[attr-defined]
        return network

    def _holds_changed(self) -> None:
        np.logical_or(self.mesh.fixed, self.holds.owner != 0, out=self.state.prescribed)
        self.state.prescribed[self.probes.rows] = True
        if self._unseeded and not self.paused:
            freed = np.unique(np.concatenate(self._unseeded))
            self._unseeded.clear()
            seeded = self._seeding.seed(self.state, freed, self._network)
            self.model.nodes_placed(seeded)
        self.model.prescribed_changed(self.state, self._moved_by_tools)
        if self._predictor is not None:
            self._predictor.prescribed_changed(self.state, self._moved_by_tools)
