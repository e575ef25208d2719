"""One session: which processes take part for a scene, and with what parameters."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from tissue_sim.compare.subject import parse_subject
from tissue_sim.launcher import Launcher, ProcessSpec, module_command
from tissue_sim.scene_file import SceneFile

CATCH_UP_SECONDS = 20.0
"""Longest wait for what listens to take what was sent."""

VIEWER_NICENESS = 5
"""What only watches stands back for what must be on time."""

TRANSPORT_VARIABLES = (
    "FASTDDS_BUILTIN_TRANSPORTS",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
)
PUBLICATION_MODE = "RMW_FASTRTPS_PUBLICATION_MODE"
SIMULATION_PROCESS = "tissue_sim"
CUT_SERVICE = "cut_service"
SCRIPT = "script"
BAG = "bag"
RERUN = "rerun"
MONITOR = "monitor"
TABLE = "table"
DIFFERENCE = "difference"
READINGS = "readings"


@dataclass(frozen=True)
class SessionPlan:
    """What takes part in a session.

    Attributes:
        scene: What is simulated.
        out: Folder of everything that is written.
        procedure: Procedure to play; None: the tools are moved by somebody else.
        clock: Clock of the procedure, "wall" or "simulation".
        bag: Whether the session is recorded as a bag.
        recording: Whether it is recorded for rerun.
        viewer: Whether rerun's viewer is opened.
        page: Whether the page of the operating table is served.
        monitor: Whether rates and latencies are counted.
        difference: Second model that the session is compared with; empty: none.
        readings: Whether stress, strain and risk regions are told.
        extra: Further parameters of nodes by process name.
    """

    scene: SceneFile
    out: Path
    procedure: Path | None = None
    clock: str = "wall"
    bag: bool = True
    recording: bool = True
    viewer: bool = False
    page: bool = False
    monitor: bool = True
    difference: str = ""
    readings: bool = False
    extra: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def parameter_file(self) -> Path:
        """Where the scene's parameters are written for this session."""
        return self.out / "parameters.yaml"

    @property
    def bag_folder(self) -> Path:
        """The bag's directory."""
        return self.out / "session"

    @property
    def recording_file(self) -> Path:
        """The recording for rerun."""
        return self.out / "session.rrd"

    @property
    def monitor_file(self) -> Path:
        """What the monitor counted."""
        return self.out / "monitor.json"

    @property
    def script_file(self) -> Path:
        """What the services answered to the script."""
        return self.out / "script.json"


def process_specs(plan: SessionPlan) -> dict[str, ProcessSpec]:
    """The processes of a session by name, in the order to start them."""
    specs = [
        _node(plan, SIMULATION_PROCESS, "tissue_sim.simulation_node", {}),
        _node(plan, CUT_SERVICE, "cut_service.cut_node", {}),
    ]
    if plan.bag:
        specs.append(
            _node(plan, BAG, "viz_bridge.bag_node", {"bag": str(plan.bag_folder)}, viewer=True)
        )
    if plan.recording or plan.viewer:
        into = ("both" if plan.viewer else "file") if plan.recording else "viewer"
        sinks = {"sink": into, "path": str(plan.recording_file)}
        specs.append(_node(plan, RERUN, "viz_bridge.rerun_node", sinks, viewer=True))
    if plan.difference:
        specs.append(
            _node(plan, DIFFERENCE, "viz_bridge.difference_node", {"model": plan.difference},
                  viewer=True)
        )  # fmt: skip
    if plan.monitor:
        specs.append(_node(plan, MONITOR, "viz_bridge.monitor", {"path": str(plan.monitor_file)}))
    if plan.readings:
        specs.append(_node(plan, READINGS, "viz_bridge.readings_node", {}, viewer=True))
    if plan.page:
        specs.append(_node(plan, TABLE, "tool_input.table_node", {}, viewer=True))
    if plan.procedure is not None:
        script = {
            "procedure": str(plan.procedure),
            "clock": plan.clock,
            "report": str(plan.script_file),
            "listeners": 1 + int(plan.bag),
        }
        specs.append(_node(plan, SCRIPT, "tool_input.script_node", script, needed=False))
    return {spec.name: spec for spec in specs}


def _node(
    plan: SessionPlan,
    name: str,
    module: str,
    parameters: Mapping[str, Any],
    viewer: bool = False,
    needed: bool = True,
) -> ProcessSpec:
    """A node with the scene's parameters for it and some of this session."""
    arguments = ["--ros-args", "--params-file", str(plan.parameter_file)]
    for key, value in {**parameters, **plan.extra.get(name, {})}.items():
        arguments += ["-p", f"{key}:={_ros_value(value)}"]
    return ProcessSpec(
        name,
        module_command(module, *arguments),
        niceness=VIEWER_NICENESS if viewer else 0,
        environment=transport(),
        needed=needed,
    )


def transport() -> dict[str, str]:
    """How the session's processes send messages, unless the user chose it.

    A frame of 40,000 nodes is half a megabyte; with sockets as small as Linux makes them by itself,
    receivers that are busy for a moment lose most of it. Sent by a thread of the middleware, it
    keeps neither the loop nor Python's lock: ten megabytes of a keyframe take tens of milliseconds.
    """
    chosen = {} if os.environ.get(PUBLICATION_MODE) else {PUBLICATION_MODE: "ASYNCHRONOUS"}
    if not any(os.environ.get(name) for name in TRANSPORT_VARIABLES):
        chosen["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4?sockets_size=4MB"
    return chosen


def _ros_value(value: Any) -> str:
    """A parameter's value as the command line of a node wants it: YAML on one line."""
    text = yaml.safe_dump(value, default_flow_style=True, width=10**6).strip()
    return text.removesuffix("\n...").strip()


def tools_of(procedure: Path) -> list[str]:
    """Tools that a procedure moves.

    Raises:
        ValueError: The procedure cannot be played.
    """
    # Here, because tool_input depends on this package.
    from tool_input.procedure import load_procedure

    return list(load_procedure(procedure).tools)


def check_second_model(text: str) -> None:
    """Refuse a second model that cannot follow a session.

    Raises:
        ValueError: It does not exist, or has values that no session keeps.
    """
    # Here, because viz_bridge depends on this package.
    from viz_bridge.second_model import checked_subject

    checked_subject(parse_subject(text))


def check_page_address(host: str) -> None:
    """Refuse an address that the page cannot listen on.

    Raises:
        ValueError: It is none of this machine's.
    """
    # Here, because tool_input depends on this package.
    from tool_input.page_guard import check_host

    check_host(host)


def with_waiting(plan: SessionPlan) -> SceneFile:
    """The scene, its clock waiting for those of the session that must not miss its beginning."""
    listeners = {"tissue/journal": 0, "tissue/state": 1, "tissue/edits": 1}  # cut_service
    recorders = int(plan.bag) + int(plan.recording or plan.viewer)
    for _ in range(recorders + bool(plan.difference)):
        listeners = {topic: count + 1 for topic, count in listeners.items()}
    if plan.monitor:
        listeners["tissue/state"] += 1
    if plan.procedure is not None and plan.clock == "simulation":
        listeners["tissue/journal"] += 1
    waits = [f"{topic}:{count}" for topic, count in listeners.items() if count]
    if plan.procedure is not None:
        waits.append("script/event:1")  # Offered when the script is ready to play.
    return plan.scene.with_simulation({"wait_for": waits}) if waits else plan.scene


def start_session(launcher: Launcher, plan: SessionPlan) -> None:
    """Write the session's parameters and start its processes."""
    with_waiting(plan).write(plan.parameter_file)
    for spec in process_specs(plan).values():
        launcher.start(spec)


def end_session(launcher: Launcher) -> None:
    """End the processes in the order of the data: sources, simulation, then those that listen."""
    for names in (
        (SCRIPT, TABLE),
        (SIMULATION_PROCESS,),
        (CUT_SERVICE, READINGS),
        (DIFFERENCE,),
        (MONITOR, BAG, RERUN),
    ):
        there = [name for name in names if name in launcher.processes]
        if {BAG, DIFFERENCE} & set(there):
            # On a busy machine seconds of a session may still wait in the recorders' queues.
            launcher.wait_until_idle(CATCH_UP_SECONDS, *there)
        if there:
            launcher.stop(*there)
