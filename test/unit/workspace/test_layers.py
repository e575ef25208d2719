"""The numeric library is plain Python: nothing in it needs ROS."""

from __future__ import annotations

import fnmatch
import subprocess
import sys
from pathlib import Path

import pytest

from support.workspace import Module, imported, modules

# Nodes, and the files that translate between messages and arrays or talk to ROS for a node.
ROS_SIDE = (
    "*/*_node.py",
    "*/conversions.py",
    "*/qos.py",
    "cut_service/closure_server.py",
    "cut_service/followed.py",
    "cut_service/internal_errors.py",
    "cut_service/patch_server.py",
    "cut_service/proposals.py",
    "cut_service/suture_server.py",
    "cut_service/tissue_watch.py",
    "tissue_sim/condition_topics.py",
    "tissue_sim/contact_messages.py",
    "tissue_sim/edit_messages.py",
    "tissue_sim/hole_messages.py",
    "tissue_sim/journal_messages.py",
    "tissue_sim/node_main.py",
    "tissue_sim/playback_client.py",
    "tissue_sim/polled_subscriptions.py",
    "tissue_sim/simulation_playback.py",
    "tissue_sim/simulation_rivals.py",
    "tissue_sim/simulation_services.py",
    "tissue_sim/simulation_tools.py",
    "tissue_sim/simulation_topics.py",
    "tissue_sim/undo_client.py",
    "tissue_sim/watching_keys.py",
    "viz_bridge/bag_play.py",
    "viz_bridge/monitor.py",
    "viz_bridge/readings_messages.py",
    "viz_bridge/recorded_topics.py",
    "viz_bridge/tools_heard.py",
    "tool_input/crtk_arm.py",
    "tool_input/diagnostics_topic.py",
    "tool_input/haptics/live_session.py",
    "tool_input/script_clock.py",
    "tool_input/script_requests.py",
    "tool_input/table/*_mode.py",
    "tool_input/table/desk.py",
    "tool_input/table/model_panel.py",
    "tool_input/table/panel.py",
    "tool_input/table/person.py",
    "tool_input/table/playback_panel.py",
    "tool_input/table/readout.py",
    "tool_input/table/requests.py",
    "tool_input/table/tool_size.py",
    "tool_input/table/view_panel.py",
    "tool_input/tool_topics.py",
)
# No file in these folders may join the list above.
NUMERIC_FOLDERS = ("geometry", "elastic", "kernels", "interaction", "compare", "readings")
ROS_PACKAGES = ("rclpy", "rcl_interfaces", "rosidl", "rmw", "launch")


def needs_ros(name: str) -> bool:
    """Whether an imported name belongs to ROS or to a message package."""
    top = name.partition(".")[0]
    return top.startswith(ROS_PACKAGES) or top.endswith(("_msgs", "_srvs", "_interfaces"))


def is_ros_side(module: Module) -> bool:
    path = module.path.as_posix()
    if set(module.name.split(".")) & set(NUMERIC_FOLDERS):
        return False
    return any(fnmatch.fnmatch(path, f"*/src/*/{pattern}") for pattern in ROS_SIDE)


NUMERIC = [module for module in modules().values() if not is_ros_side(module)]


@pytest.mark.parametrize("module", NUMERIC, ids=lambda module: module.name)
def test_numeric_core_imports_no_ros(module: Module) -> None:
    found = [name for name in imported(module) if needs_ros(name)]
    assert found == [], "a helper that talks to ROS for a node belongs into ROS_SIDE"


BLOCKED_IMPORTS = """
import importlib, sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"rclpy", "tissue_interfaces", "std_msgs", "geometry_msgs"}:
            raise ModuleNotFoundError(f"{name} is blocked")

sys.meta_path.insert(0, NoRos())
for name in sys.argv[1:]:
    importlib.import_module(name)
"""


def test_numeric_core_runs_where_ros_is_not_installed(tmp_path: Path) -> None:
    """Also through what the modules import in turn."""
    names = [m.name for m in NUMERIC if m.package in ("tissue_sim", "cut_service")]
    result = subprocess.run(
        [sys.executable, "-c", BLOCKED_IMPORTS, *names],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert result.returncode == 0, result.stderr
