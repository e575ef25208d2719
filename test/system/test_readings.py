"""Simulation and readings node as processes: stress, histories, risk regions and their warnings."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from std_srvs.srv import Trigger
from tissue_interfaces.msg import NodeScalar, Readings, RiskRegion, RiskRegions
from tissue_interfaces.srv import Grab, SetRiskRegion

from support.processes import processes
from support.simulation_process import Client, client, eventually, simulation
from tissue_sim import conversions, qos

HEARD = {
    "tissue/readings": (Readings, qos.READINGS),
    "tissue/scalar": (NodeScalar, qos.STATE),
    "tissue/risk_regions": (RiskRegions, qos.LATCHED),
}
SIDE = 0.05
"""Of the block [m]."""

BLOCK: dict[str, Any] = {
    "shape__size_x": SIDE, "shape__size_y": SIDE, "shape__size_z": SIDE, "fixed": "low:z:0.1",
    "model": "finite_element", "poisson_ratio": 0.3, "young_modulus": 5e4, "rate_hz": 30.0,
    "tools": ["grip"], "tool__grip__size": [0.012], "pose_timeout": 3600.0,
    "release_timeout": 3600.0,
}  # fmt: skip
TOP = np.array([SIDE, SIDE, SIDE])
BASE = "risk_regions: [{name: base, points: [[0, 0, 0]], radius: 0.015, stress_limit: 1.0e9}]"


def readings_of(message: Readings) -> dict[str, Any]:
    return {reading.name: reading for reading in message.readings}


def warnings_of(message: Readings) -> set[tuple[str, str, bool]]:
    return {(w.what, w.tool, w.begins) for w in message.warnings}


def set_scalar(seen: Client, name: str) -> bool:
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=name)
    answer = seen.call(
        SetParameters,
        "readings/set_parameters",
        parameters=[ParameterMsg(name="scalar", value=value)],
    )
    return bool(answer.results[0].successful)


def paint(seen: Client, name: str, place: list[float], **more: Any) -> SetRiskRegion.Response:
    region = RiskRegion(name=name, margin=0.01, stress_limit=2000.0)
    fields = {"region": region, "positions": place, "radius": 0.015, **more}
    return seen.call(SetRiskRegion, "tissue/set_risk_region", **fields)


def test_pulled_tissue_tells_its_stress_and_warns(ros_domain: int, tmp_path: Path) -> None:
    with processes(tmp_path) as made, client() as seen:
        seen.hear("tissue/topology", "tissue/state", "tissue/tools")
        for topic, (message, profile) in HEARD.items():
            seen.node.create_subscription(message, topic, seen.heard[topic].append, profile)

        def reading(wanted: Callable[[Readings], Any]) -> Any:
            return seen.next("tissue/readings", wanted)

        (tmp_path / "risk.yaml").write_text(BASE)
        made.start(
            "readings", "viz_bridge.readings_node", "--ros-args", "-p", "rate_hz:=20.0",
            "-p", "risk_file:=risk.yaml", "-p", "risk_margin:=0.001",
        )  # fmt: skip
        # Before there is tissue, there is nothing to paint on.
        early = paint(seen, "corner", TOP.tolist())
        assert early.error_code == SetRiskRegion.Response.NO_TISSUE
        with simulation(tmp_path, **BLOCK):
            still = reading(lambda m: "von_mises_stress" in readings_of(m))
            assert readings_of(still)["displacement"].peak < 1e-6
            assert not still.warnings
            mesh = conversions.topology_to_mesh(seen.last("tissue/topology"))

            # What the file says is there, before anybody has painted.
            base = seen.first("tissue/risk_regions", lambda m: m.regions).regions[0]
            assert (base.name, base.margin, base.stress_limit) == ("base", 0.001, 1e9)
            near = np.linalg.norm(mesh.rest[: mesh.node_rows], axis=1) <= 0.015
            np.testing.assert_array_equal(np.array(base.nodes), np.flatnonzero(near))

            # Regions that are refused change nothing; painted ones are told to everybody.
            assert paint(seen, "", TOP.tolist()).error_code == SetRiskRegion.Response.INVALID
            far = paint(seen, "corner", [9.0, 9.0, 9.0])
            assert far.error_code == SetRiskRegion.Response.NOTHING_THERE
            gone = paint(seen, "nerve", TOP.tolist(), remove=True)
            assert gone.error_code == SetRiskRegion.Response.UNKNOWN_REGION
            painted = paint(seen, "corner", TOP.tolist(), request_id="a")
            assert painted.success, painted.message
            region = seen.first("tissue/risk_regions", lambda m: len(m.regions) == 2).regions[1]
            assert region.name == "corner"
            near = np.linalg.norm(mesh.rest[: mesh.node_rows] - TOP, axis=1) <= 0.015
            np.testing.assert_array_equal(np.array(region.nodes), np.flatnonzero(near))
            assert painted.nodes == near.sum() > 0
            assert paint(seen, "corner", [9.0, 9.0, 9.0], request_id="a").success

            # The tool comes near, takes hold of it and pulls.
            seen.place("grip", [SIDE, SIDE, SIDE + 0.02])
            reading(lambda m: ("near", "grip", True) in warnings_of(m))
            seen.place("grip", TOP.tolist())
            assert seen.call(Grab, "tissue/grab", tool="grip", request_id="").success
            reading(lambda m: ("touched", "grip", True) in warnings_of(m))
            assert set_scalar(seen, "von_mises_stress")
            assert not set_scalar(seen, "temperature")
            seen.place("grip", [SIDE, SIDE, SIDE + 0.01])
            pulled = reading(lambda m: ("stress", "", True) in warnings_of(m))
            stress = readings_of(pulled)["von_mises_stress"]
            assert stress.peak > 2000.0
            assert stress.integrated > 0.0
            assert 0.0 <= pulled.sim_time - stress.highest_at < 60.0
            scalar = seen.next("tissue/scalar")
            assert (scalar.name, scalar.unit) == ("von_mises_stress", "Pa")
            values = np.array(scalar.values)
            assert len(values) == mesh.node_rows
            same = seen.first("tissue/readings", lambda m: m.frame == scalar.frame)
            told = readings_of(same)["von_mises_stress"]
            assert values[told.peak_node] == np.float32(told.peak) == values.max()

            # Without the region each warning ends once; the highest stress stays until a reset.
            remove = paint(seen, "corner", [], remove=True, request_id="b")
            assert remove.success
            assert paint(seen, "corner", [], remove=True, request_id="b").success
            eventually(
                lambda: [r.name for r in seen.last("tissue/risk_regions").regions] == ["base"]
            )
            reading(lambda m: not m.warnings)
            ended = [w for m in list(seen.heard["tissue/readings"]) for w in m.warnings]
            over = [(w.what, w.tool) for w in ended if not w.begins]
            assert sorted(over) == sorted(set(over))
            assert ("stress", "") in over
            assert seen.call(Trigger, "tissue/reset_readings").success
            anew = reading(lambda m: True)
            assert readings_of(anew)["von_mises_stress"].highest_at > stress.highest_at
        assert made.end("readings", signal.SIGINT) == 0
