"""The node that steps the tissue: `python -m tissue_sim.simulation_node`."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import sys
import threading
import time

from builtin_interfaces.msg import Time
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.parameter import Parameter
from tissue_interfaces.msg import Status, Topology

from tissue_sim import conversions
from tissue_sim.condition_topics import ConditionTopics
from tissue_sim.diagnostics import LoopStatistics, tool_findings, wiring_finding
from tissue_sim.frame import Frame
from tissue_sim.geometry import scene_geometry
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.contact_model import ContactModel, ContactModels
from tissue_sim.interaction.reaction import NOTHING, ForceLimiter
from tissue_sim.interaction.tracker import ACTIVE, FREE
from tissue_sim.live import LiveSimulation, mesh_for_keyframe
from tissue_sim.node_main import declare, overrides, run
from tissue_sim.playback.parameters import clock_of, player_of
from tissue_sim.playback.played import PlayedSimulation
from tissue_sim.realtime import FixedRate, start_loop
from tissue_sim.rehearsal import rehearse
from tissue_sim.simulation import Simulation
from tissue_sim.simulation_parameters import Settings, force_limits, specs, tool_limits
from tissue_sim.simulation_playback import PlaybackTopics
from tissue_sim.simulation_rivals import Rivals
from tissue_sim.simulation_services import SimulationServices
from tissue_sim.simulation_tools import ToolSources
from tissue_sim.simulation_topics import Keyframes, SimulationTopics

NODE = "tissue_sim"
MARGIN = 0.06
"""Share of the period that steps leave for what nobody foresees."""

SHOWN_AGAIN = 0.2
"""Period in which what is shown of a recording that stands is published again [s]."""

HOUSEKEEPING = 1.0
"""Period of diagnostics and of what the loop looks after between frames [s]."""


class SimulationNode(Node):
    """Messages in the executor's thread, frames in the loop thread.

    Attributes:
        exit_code: What the process ends with.
    """

    def __init__(self) -> None:
        super().__init__(NODE)
        self.exit_code = 0
        self._values = declare(self, specs(overrides(self)))
        self._settings = Settings.of(self._values)
        self._topics = SimulationTopics(self, self._settings.frames.organ)
        self._conditions = ConditionTopics(self, self._settings.frames.organ)
        self._rivals = Rivals(self, self._topics.state.topic_name)
        self._keyframes = Keyframes(self._topics)
        self._statistics = LoopStatistics()
        self._stop = threading.Event()
        self._limiters: dict[str, ForceLimiter] = {}
        self._contacts = ContactModels()
        self._force_limits = self._settings.force_limits
        self._message = ""
        self._unknown_tools: list[str] = []
        self._switched = 0
        self._looked_after = 0.0
        # What comes after the steps, lately: they stop early enough for publishing in time.
        self._reserve = 0.002
        self._say(bytes(16), 0, Status.LOADING, "loading")
        self._live = self._played() if self._values["playback.bag"] else self._operated()
        self._rivals.refuse()
        self._rate = FixedRate(self._live.simulation.scene.rate_hz)
        self._shown: Frame | None = None
        self._shown_at = 0.0
        self._sources = ToolSources(self, self._live, self._settings.frames)
        self._sources.follow(self._live.simulation.tools)
        self._served = SimulationServices(
            self, self._live, self._settings.frames.organ, self._follow_tools
        )
        if isinstance(self._live, PlayedSimulation):
            PlaybackTopics(
                self, self._live, self._served, self._settings.frames.organ, self._follow_tools
            )
        self._keyframes.publish(self._live.prepared, time.perf_counter())
        # Before the first frame: the clock may wait for a script that wants to know the tools.
        self._topics.publish_tools(list(self._live.trackers.values()), self._now())
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._on_parameters)
        group = MutuallyExclusiveCallbackGroup()
        self.create_timer(HOUSEKEEPING, self._diagnose, callback_group=group)
        self._rivals.watch(lambda: self._live.simulation.epoch, self._give_way)
        priority = self._values["realtime_priority"]
        self._thread = start_loop(self._run, priority, self.get_logger().info)

    def close(self) -> None:
        """End the loop and wait for it."""
        self._stop.set()
        if hasattr(self, "_thread"):
            self._thread.join(timeout=10.0)
            self._keyframes.finish()

    # Starting

    def _operated(self) -> LiveSimulation:
        """A simulation of the scene."""
        settings = self._settings
        return LiveSimulation(
            self._load(), settings.limits, settings.data_dir, settings.budget,
            settings.steps_per_frame, self._first_keyframe,
        )  # fmt: skip

    def _played(self) -> LiveSimulation:
        """A simulation that plays a recording."""
        settings = self._settings
        player = player_of(self._values)
        rehearse(sheet=player.simulation.mesh.sheet is not None)
        self.get_logger().info(f"playing {player.recording}, {player.recording.organ}")
        return PlayedSimulation(
            player, clock_of(self._values), settings.limits, settings.data_dir, settings.budget,
            settings.steps_per_frame, self._first_keyframe,
        )  # fmt: skip

    def _load(self) -> Simulation:
        values = self._values
        announced = scene_geometry.announcement(values["geometry"], self._settings.shape)
        if announced:
            self.get_logger().info(announced)
        geometry = scene_geometry.load(
            values["geometry"],
            units=values["units"] or None,
            fixed=values["fixed"],
            parameters=self._settings.shape,
            cell=values["cell"] or None,
            regions=self._settings.regions,
            fibres=values["fibres"],
            sheet=self._settings.sheet,
        )
        for line in geometry.report.mended:
            self.get_logger().info(line)
        self.get_logger().info("getting kernels ready; the first time that takes minutes")
        rehearse(sheet=geometry.mesh.sheet is not None)
        seed = values["seed"]
        epoch = hashlib.blake2b(str(seed).encode(), digest_size=16).digest() if seed else None
        simulation = Simulation(geometry.mesh, self._settings.scene, epoch)
        mesh = geometry.mesh
        made_of = f"{mesh.element_rows} tetrahedra"
        if mesh.sheet is not None:
            made_of = f"{len(mesh.sheet.triangles)} triangles"
        self.get_logger().info(
            f"{mesh.name}: {mesh.node_rows} nodes, {made_of}, "
            f"{int(mesh.fixed.sum())} fixed, model {simulation.model.name}"
        )
        return simulation

    def _give_way(self, reason: str) -> None:
        self.get_logger().fatal(reason)
        self.exit_code = 2
        self.context.try_shutdown()

    def _first_keyframe(self, simulation: Simulation) -> Topology:
        mesh = mesh_for_keyframe(simulation.mesh)
        return self._keyframes.make(mesh, simulation.epoch, self._now())

    # The loop thread

    def _run(self) -> None:
        try:
            self._wait_for_others()
            self._rate.start()
            while self._rate.wait(self._stop):
                self._frame()
                if 0 < self._values["frames"] == self._statistics.frames:
                    self._finish()
                    return
        except Exception as error:
            if not self.context.ok():
                return  # Ctrl-C took the publishers away in the middle of a frame.
            # The loop must not end silently: whoever looks at the status or the exit code sees it.
            self.exit_code = 1
            self.get_logger().fatal(f"the simulation failed: {type(error).__name__}: {error}")
            import traceback

            traceback.print_exc()
            simulation = self._live.simulation
            self._say(simulation.epoch, simulation.mesh.version, Status.FAILED, str(error))
            self.context.try_shutdown()
        finally:
            self._served.stop()

    def _frame(self) -> None:
        stamp = self._now()
        begun = time.perf_counter()
        self._sources.take()
        until = self._rate.late_at - self._reserve - MARGIN * self._rate.period
        if not self._live.due(until):
            self._stand(begun, stamp)
            return
        frame, answer = self._live.next_frame(begun, until)
        advanced = time.perf_counter()
        if self._live.switched != self._switched:
            self._switched = self._live.switched
            self._keyframes.publish(self._live.prepared, begun)
            self._limiters.clear()
            self._contacts = ContactModels()
        self._topics.publish_frame(frame, stamp)
        self._publish_tools(frame, stamp)
        published = time.perf_counter()
        late = self._rate.published()
        answer()
        after_steps = published - frame.stepped_at
        self._reserve = min(max(after_steps, 0.98 * self._reserve), 0.25 * self._rate.period)
        self._statistics.add(frame, published - begun, published - advanced)
        self._shown, self._shown_at = frame, published
        self._after(frame, late, stamp)

    def _stand(self, now: float, stamp: Time) -> None:
        """There is nothing new to show: who comes only now is shown what there is."""
        self._statistics.stood += 1
        self._rate.published()
        self._say_how_it_is(self._live.simulation)
        if self._shown and not self._live.loading and now - self._shown_at > SHOWN_AGAIN:
            self._shown_at = now
            self._topics.publish_state(self._shown, stamp)
        if now - self._looked_after > HOUSEKEEPING and not self._live.loading:
            self._looked_after = now
            gc.collect()

    def _publish_tools(self, frame: Frame, stamp: Time) -> None:
        simulation, live = self._live.simulation, self._live
        has_forces = simulation.model.has_forces
        quiet = live.paused or live.loading or bool(frame.lost)
        for tool, topics in self._sources.topics.items():
            tracker = live.trackers.get(tool)
            if tracker is None or tool not in simulation.poses:
                continue
            limiter = self._limiters.setdefault(tool, ForceLimiter(self._force_limits))
            limiter.limits = self._force_limits
            may_push = not quiet and tracker.state in (ACTIVE, FREE)
            wanted = frame.wrenches.get(tool, NOTHING) if may_push else None
            # What a blade feels does not come from the model.
            felt = has_forces or tool in frame.wrenches or limiter.wrench.any()
            wrench = limiter.next(wanted, self._rate.period) if felt else None
            # A tool removed just now has no publishers any more.
            with contextlib.suppress(InvalidHandle):
                topics.publish(simulation.poses[tool], wrench, stamp)
                if topics.contact_wanted:
                    pose = simulation.poses[tool]
                    touches = self._contacts.of(simulation, tool) if may_push else None
                    topics.publish_contact(touches or ContactModel(pose), stamp)

    def _after(self, frame: Frame, late: bool, stamp: Time) -> None:
        """What can wait until the frame is published."""
        simulation, now = self._live.simulation, time.perf_counter()
        for event in frame.events:
            self.get_logger().info(event)
            self._message = event
        if frame.lost:
            self.get_logger().error(frame.lost, throttle_duration_sec=1.0)
            self._message = frame.lost
        self._say_how_it_is(simulation)
        self._topics.publish_tools(list(self._live.trackers.values()), stamp)
        self._conditions.publish(simulation, stamp)
        self._keyframes.publish_made(now, self._rate.slack())
        self._keyframes.unkeyed += len(frame.edits)
        if self._keyframes.wanted(now) and (
            not late or self._keyframes.unkeyed >= 256 or now - self._looked_after > 2.0
        ):
            mesh = mesh_for_keyframe(simulation.mesh)
            self._keyframes.begin(mesh, simulation.epoch, now, stamp)
        elif now - self._looked_after > HOUSEKEEPING and self._rate.slack() > 0.004:
            self._looked_after = now
            self._statistics.residual = simulation.model.residual(simulation.state)
            pulls = simulation.suture_forces()
            self._statistics.sutures = len(pulls)
            self._statistics.suture_forces = float(pulls.sum()), float(pulls.max(initial=0.0))
            # Quick, since everything from before the loop is frozen.
            gc.collect()

    def _finish(self) -> None:
        """The number of frames asked for is done: let everybody have the last one, then end."""
        self._keyframes.finish()
        patience = Duration(seconds=2.0)
        self._topics.state.wait_for_all_acked(patience)
        self._topics.journal.wait_for_all_acked(patience)
        self.context.try_shutdown()

    def _wait_for_others(self) -> None:
        """Hold the clock until those that must not miss anything are there."""
        deadline = time.perf_counter() + self._values["wait_timeout"]
        missing = self._missing()
        while missing and time.perf_counter() < deadline and not self._stop.wait(0.02):
            missing = self._missing()
        if missing:
            self._message = f"started without {', '.join(missing)}"
            self.get_logger().warning(self._message)

    def _missing(self) -> list[str]:
        own = {publisher.topic_name: publisher for publisher in self.publishers}
        missing = []
        for topic, count in self._settings.wait_for.items():
            name = self.resolve_topic_name(topic)
            if name in own:
                there = own[name].get_subscription_count()
            else:
                there = self.count_publishers(name)
            if there < count:
                missing.append(f"{topic} ({there} of {count})")
        return missing

    # The executor's thread

    def _follow_tools(self) -> None:
        self._sources.follow(list(self._live.simulation.tools))

    def _check_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        """Whether the parameters go together; limits of each were checked before."""
        try:
            tool_limits({**self._values, **{change.name: change.value for change in changes}})
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_parameters(self, changes: list[Parameter]) -> None:
        self._values.update({change.name: change.value for change in changes})
        self._live.budget = self._values["budget_ms"] / 1000.0
        self._live.steps_per_frame = self._values["steps_per_frame"]
        self._live.post_limits(tool_limits(self._values))
        self._force_limits = force_limits(self._values)

    def _diagnose(self) -> None:
        simulation = self._live.simulation
        unknown = self._sources.watch_sources()
        for tool in unknown:
            if tool not in self._unknown_tools:
                known = ", ".join(simulation.tools) or "none"
                self.get_logger().warning(
                    f"poses are published for unknown tool {tool}; known tools: {known}"
                )
        self._unknown_tools = unknown
        self._statistics.components = self._keyframes.components
        findings = [
            *self._statistics.report(
                self._rate, time.perf_counter(), simulation.paused, simulation.model.name
            ),
            *tool_findings(self._live.trackers.values()),
            wiring_finding(
                self.count_publishers(self._topics.state.topic_name),
                unknown,
                simulation.tools,
                [*self._topics.bad_qos.values(), *self._sources.bad_qos.values()],
            ),
        ]
        self._topics.publish_diagnostics(self.get_fully_qualified_name(), findings, self._now())

    # Both

    def _say_how_it_is(self, simulation: Simulation) -> None:
        state = Status.PAUSED if self._live.paused else Status.READY
        if self._live.loading:
            state = Status.LOADING
        self._say(simulation.epoch, simulation.mesh.version, state, self._message)

    def _say(self, epoch: bytes, version: int, state: int, message: str) -> None:
        live = getattr(self, "_live", None)
        organ: Mesh | None = live.simulation.mesh if live else None
        self._topics.publish_status(
            epoch,
            version,
            organ.name if organ else self._values["geometry"],
            live.simulation.model.name if live else self._values["model"],
            state,
            live.busy_with if live else "",
            message,
            self._now(),
            round(live.progress, 2) if live and live.busy_with else 0.0,
        )

    def _now(self) -> Time:
        return conversions.stamp_of(time.time_ns())


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(SimulationNode, args)


if __name__ == "__main__":
    sys.exit(main())
