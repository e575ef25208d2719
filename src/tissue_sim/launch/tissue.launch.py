"""Starts a scene on a full ROS 2 installation: simulation, cutting and what is asked for besides.

ros2 launch tissue_sim tissue.launch.py scene:=heart procedure:=demo.yaml bag:=session
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

ARGUMENTS = {
    "scene": ("heart", "a scene (wall, block, sphere_shell, heart) or a parameter file"),
    "procedure": ("", "procedure to play (YAML); empty: none"),
    "bag": ("", "bag directory to record; empty: none"),
    "rrd": ("", "recording for rerun; empty: none"),
    "difference": ("", "second model to compare the session with; empty: none"),
    "readings": ("false", "whether to tell stress, strain and risk regions"),
    "page": ("true", "whether to serve the operating table, a page in the browser"),
    "bind": ("127.0.0.1", "address the page listens on; 0.0.0.0: all of this machine's"),
    "namespace": ("", "namespace of all nodes"),
}


def parameter_file(scene: str) -> str:
    """File of a scene that comes with the project, or the file that was named."""
    if scene.endswith((".yaml", ".yml")):
        return scene
    return str(Path(get_package_share_directory("tissue_sim")) / "config" / f"{scene}.yaml")


def nodes(context: LaunchContext) -> list[Node | LogInfo]:
    """The nodes the arguments ask for."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    scene = parameter_file(given["scene"])
    where = given["namespace"]
    # The clock waits for the recorders: a journal that misses frame 1 cannot be replayed.
    recorders = sum(bool(given[name]) for name in ("bag", "rrd", "difference"))
    waiting = [{"wait_for": [f"tissue/journal:{recorders}"]}] if recorders else []
    chosen: list[Node | LogInfo] = [
        LogInfo(msg=f"scene {scene}"),
        Node(
            package="tissue_sim",
            executable="simulation_node",
            namespace=where,
            parameters=[scene, *waiting],
            output="screen",
        ),
        Node(package="cut_service", executable="cut_node", namespace=where, parameters=[scene]),
    ]
    if given["bag"]:
        bag = Node(
            package="viz_bridge",
            executable="bag_node",
            namespace=where,
            parameters=[scene, {"bag": given["bag"]}],
        )
        chosen.append(bag)
    if given["rrd"]:
        rerun = Node(
            package="viz_bridge",
            executable="rerun_node",
            namespace=where,
            parameters=[scene, {"sink": "file", "path": given["rrd"]}],
        )
        chosen.append(rerun)
    if given["difference"]:
        difference = Node(
            package="viz_bridge",
            executable="difference_node",
            namespace=where,
            parameters=[scene, {"model": given["difference"]}],
        )
        chosen.append(difference)
    if given["readings"].lower() in ("true", "1", "yes"):
        readings = Node(
            package="viz_bridge", executable="readings_node", namespace=where, parameters=[scene]
        )
        chosen.append(readings)
    if given["page"].lower() in ("true", "1", "yes"):
        page = Node(
            package="tool_input",
            executable="table_node",
            namespace=where,
            parameters=[scene, {"host": given["bind"]}],
            output="screen",
        )
        chosen.append(page)
    if given["procedure"]:
        script = Node(
            package="tool_input",
            executable="script_node",
            namespace=where,
            parameters=[scene, {"procedure": given["procedure"]}],
            output="screen",
        )
        chosen.append(script)
    return chosen


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
