"""A haptic arm beside a running simulation: real processes, forces that are bounded and end."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.context import Context
from std_msgs.msg import Bool
from tissue_interfaces.msg import ContactModel

from support.fake_simulation import spinning, wait_for
from support.observer import PATIENCE, Observer
from support.processes import Processes, processes
from tissue_sim import qos
from tissue_sim.contact_messages import contact_from_msg

TIP = [0.032, 0.05, 0.02]
"""Above the middle of the wall."""
MAX_FORCE = 1.5


class Feeling(Observer):
    """Hears the forces of the arm and the contact models of its tool.

    Attributes:
        forces: Sizes of all forces heard [N], in order.
        models: The contact models heard.
    """

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.forces: list[float] = []
        self.models: list[ContactModel] = []
        self.enable = self.create_publisher(Bool, "pedal", qos.USE)
        self.create_subscription(WrenchStamped, "arm/servo_cf", self._on_force, qos.POSE_IN)

    def feel(self) -> None:
        """Listen to the contact models."""
        topic = "tools/finger/contact_model"
        self.create_subscription(ContactModel, topic, self.models.append, qos.MEASURED)

    def _on_force(self, message: WrenchStamped) -> None:
        force = message.wrench.force
        self.forces.append(float(np.linalg.norm([force.x, force.y, force.z])))

    def silent_for(self, count: int) -> bool:
        """Whether so many of the last forces heard are none."""
        return len(self.forces) > count and not any(self.forces[-count:])


@pytest.fixture
def world(ros_domain: int, tmp_path: Path) -> Iterator[Processes]:
    with processes(tmp_path) as made:
        yield made


def test_an_arm_feels_the_wall_until_it_is_gone(world: Processes, ros_domain: int) -> None:
    with spinning(ros_domain, Feeling) as seen:
        world.start(
            "simulation", "tissue_sim.simulation_node", "--ros-args", "-p", "geometry:=wall",
            "-p", "fixed:=set:fixed", "-p", "steps_per_frame:=2", "-p", "tools:=[finger]",
            "-p", "tool.finger.kind:=probe", "-p", "tool.finger.size:=[0.008]",
            "-p", f"tool.finger.position:={TIP}", "-p", "wait_for:=['tissue/journal:1']",
        )  # fmt: skip
        world.start(
            "haptic", "tool_input.haptic_node", "--ros-args", "-p", "arm:=arm",
            "-p", "tool:=finger", "-p", f"max_force:={MAX_FORCE}", "-p", "enable_topic:=pedal",
        )  # fmt: skip
        seen.wait_ready()
        seen.feel()
        world.start(
            "arm", "tool_input.virtual_arm_node", "--ros-args", "-p", f"position:={TIP}",
            "-p", "stroke:=[0.0, 0.0, -0.013]", "-p", "closes_after:=0.0",
            "-p", "report:=arm.json",
        )  # fmt: skip
        wait_for(lambda: any(model.contact for model in seen.models), PATIENCE, "contact")
        said = "/haptic: force"
        wait_for(lambda: "pedal does not say true" in seen.finding(said), 60.0, "the dead man")
        wait_for(lambda: len(seen.forces) > 20, 60.0, "forces")
        assert not any(seen.forces)

        seen.enable.publish(Bool(data=True))
        wait_for(lambda: max(seen.forces) > 0.2, 60.0, "a force")
        seen.enable.publish(Bool(data=False))
        wait_for(lambda: seen.silent_for(100), 60.0, "no force")
        seen.enable.publish(Bool(data=True))
        wait_for(lambda: max(seen.forces[-100:]) > 0.2, 60.0, "the force again")

        assert world.end("arm", signal.SIGTERM) == 0
        silence = "no pose of arm for more than 0.05 s"
        wait_for(lambda: silence in seen.finding(said), 60.0, "the silence in diagnostics")
        wait_for(lambda: seen.silent_for(100), 60.0, "no force")
        wait_for(
            lambda: "for more than 0.5 s" in seen.finding("/haptic: input"), 60.0, "the unplugging"
        )
        # The probe was pressed: it stops where it is, and then presses no more.
        wait_for(lambda: seen.tools["finger"].state == "frozen", 60.0, "the freeze")
        wait_for(lambda: "let go" in seen.tools["finger"].reason, 60.0, "the end of the press")
        wait_for(lambda: "let go" in seen.finding("/tissue_sim: tool finger"), 60.0, "diagnostics")
        assert world.end("haptic", signal.SIGINT) == 0
        assert max(seen.forces) <= MAX_FORCE + 1e-9
        for message in seen.models:
            model = contact_from_msg(message)
            assert model.contact == bool(model.stiffness.any() or model.wrench.any())
            np.testing.assert_allclose(model.stiffness, model.stiffness.T, atol=1e-9)
    measured = json.loads((world.folder / "arm.json").read_text())
    # How fast it is depends on the machine: it is reported, in docs/results/haptics.json too.
    print(f"{measured['forces_per_second']:.0f} forces a second, {measured['pose_to_force_ms']}")
    assert measured["forces"] > 0
