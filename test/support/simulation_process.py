"""The simulation's node as a process of its own, and a client that talks to it."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import Bool
from tissue_interfaces.msg import (
    CutRequest,
    Journal,
    Status,
    TissueState,
    ToolList,
    Topology,
    TopologyEdit,
)

from support.spinner import Spinner
from tissue_sim import conversions, qos

PATIENCE = 60.0
"""Longest wait for anything [s]; only a failing test waits so long."""

Found = TypeVar("Found")

TOPICS: dict[str, tuple[type, Any]] = {
    "tissue/state": (TissueState, qos.STATE),
    "tissue/journal": (Journal, qos.JOURNAL),
    "tissue/topology": (Topology, qos.LATCHED),
    "tissue/edits": (TopologyEdit, qos.EDITS),
    "tissue/status": (Status, qos.LATCHED),
    "tissue/tools": (ToolList, qos.LATCHED),
    "tissue/cut_request": (CutRequest, qos.CUT_REQUEST),
    "/diagnostics": (DiagnosticArray, qos.DIAGNOSTICS),
}


def eventually(find: Callable[[], Found], patience: float = PATIENCE) -> Found:
    """The first result that counts as true; fails when there is none in time."""
    deadline = time.monotonic() + patience
    while True:
        found = find()
        if found:
            return found
        assert time.monotonic() < deadline, f"nothing within {patience:g} s"
        time.sleep(0.01)


class SimulationProcess:
    """A running node; its output goes to a file."""

    def __init__(
        self, folder: Path, parameters: dict[str, Any], namespace: str = "", name: str = "sim"
    ) -> None:
        self.log = folder / f"{name}_{time.monotonic_ns()}.txt"
        values = {
            "geometry": "block",
            "shape.nodes_x": 5, "shape.nodes_y": 5, "shape.nodes_z": 5,
            "data_dir": str(folder / "data"),
            **parameters,
        }  # fmt: skip
        file = folder / f"{self.log.stem}.yaml"
        file.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
        command = [sys.executable, "-m", "tissue_sim.simulation_node", "--ros-args"]
        command += ["--params-file", str(file)]
        if namespace:
            command += ["-r", f"__ns:={namespace}"]
        with self.log.open("wb") as output:
            self.process = subprocess.Popen(
                command, stdout=output, stderr=subprocess.STDOUT, env=os.environ.copy()
            )

    @property
    def output(self) -> str:
        """What it has printed."""
        return self.log.read_text(errors="replace")

    def wait(self, patience: float = PATIENCE) -> int:
        """Its exit code."""
        return self.process.wait(timeout=patience)

    def interrupt(self) -> int:
        """Press Ctrl-C and wait for the end."""
        self.process.send_signal(signal.SIGINT)
        return self.wait()

    def kill(self) -> None:
        """End it at once."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()


@contextlib.contextmanager
def simulation(folder: Path, namespace: str = "", **parameters: Any) -> Iterator[SimulationProcess]:
    """A running node, ended at the end; `__` in a parameter's name stands for a dot."""
    named = {key.replace("__", "."): value for key, value in parameters.items()}
    process = SimulationProcess(folder, named, namespace)
    try:
        yield process
    finally:
        process.kill()


class Client:
    """A node in a context of its own that hears everything and asks for things."""

    def __init__(self, namespace: str = "", name: str = "client") -> None:
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node(name, namespace=namespace, context=self.context)
        self.heard: dict[str, list[Any]] = defaultdict(list)
        self._clients: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}
        self._spinner = Spinner(self.node)

    def close(self) -> None:
        """Leave the domain."""
        self._spinner.stop()

    def hear(self, *topics: str) -> None:
        """Keep every message of topics in `heard`."""
        for topic in topics:
            if topic in TOPICS:
                message, profile = TOPICS[topic]
            else:
                message = WrenchStamped if topic.endswith("_cf") else PoseStamped
                profile = qos.MEASURED
            self.node.create_subscription(message, topic, self.heard[topic].append, profile)

    def first(self, topic: str, wanted: Callable[[Any], Any] = lambda _: True) -> Any:
        """The first message heard that is wanted, waiting for it if need be."""
        return eventually(lambda: next((m for m in list(self.heard[topic]) if wanted(m)), None))

    def last(self, topic: str) -> Any:
        """The newest message, waiting for one if need be."""
        self.first(topic)
        return self.heard[topic][-1]

    def next(self, topic: str, wanted: Callable[[Any], Any] = lambda _: True) -> Any:
        """The first message wanted among those heard from now on."""
        count = len(self.heard[topic])
        return eventually(
            lambda: next((m for m in list(self.heard[topic])[count:] if wanted(m)), None)
        )

    def finding(self, name: str, said: str, doing: Callable[[], Any] = lambda: None) -> Any:
        """The first finding of /diagnostics whose name and message contain this.

        Args:
            name: What it is about.
            said: Part of its message.
            doing: Done again and again until it is found.
        """

        def find() -> Any:
            doing()
            for array in list(self.heard["/diagnostics"]):
                for status in array.status:
                    if name in status.name and said in status.message:
                        return status
            return None

        return eventually(find)

    def call_async(self, service: type, name: str, /, **fields: Any) -> Any:
        """Ask; gives a future."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(service, name)
        client = self._clients[name]
        assert client.wait_for_service(timeout_sec=PATIENCE)
        return client.call_async(service.Request(**fields))  # type: ignore[attr-defined]

    def call(self, service: type, name: str, /, **fields: Any) -> Any:
        """Ask and wait for the answer."""
        future = self.call_async(service, name, **fields)
        return eventually(lambda: future.result() if future.done() else None)

    def publisher(self, message: type, topic: str, profile: Any) -> Any:
        """A publisher that somebody listens to."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(message, topic, profile)
            eventually(lambda: self._publishers[topic].get_subscription_count())
        return self._publishers[topic]

    def pose(
        self, tool: str, position: Any, frame: str = "organ", turn: Any = (0.0, 0.0, 0.0, 1.0)
    ) -> PoseStamped:
        """Publish a pose with the stamp of now."""
        message = conversions.pose_stamped([*position, *turn], frame, self.stamp())
        self.publisher(PoseStamped, f"tools/{tool}/servo_cp", qos.POSE).publish(message)
        return message

    def place(self, tool: str, position: Any, **more: Any) -> PoseStamped:
        """Publish a pose until it has been applied; the first ones may find nobody listening."""
        topic = f"tools/{tool}/measured_cp"
        if topic not in self.heard:
            self.hear(topic)
        sent: list[Any] = []

        def arrived() -> bool:
            sent.append(self.pose(tool, position, **more))
            time.sleep(0.01)
            place = self.heard[topic][-1].pose.position if self.heard[topic] else None
            return place is not None and [place.x, place.y, place.z] == list(position)

        eventually(arrived)
        return sent[-1]

    def use(self, tool: str, pressed: bool) -> None:
        """Press or release."""
        self.publisher(Bool, f"tools/{tool}/use", qos.USE).publish(Bool(data=pressed))

    def stamp(self) -> Any:
        """The time of now."""
        return conversions.stamp_of(time.time_ns())


@contextlib.contextmanager
def client(namespace: str = "", name: str = "client") -> Iterator[Client]:
    """A client, closed at the end."""
    made = Client(namespace, name)
    try:
        yield made
    finally:
        made.close()
