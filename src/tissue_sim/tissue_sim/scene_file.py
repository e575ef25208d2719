"""What `tissue run` is asked to simulate: a scene file, or any mesh, as parameters of the nodes."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

SIMULATION = "/**/tissue_sim"
"""Key of the simulation's parameters in a scene file, under whatever namespace it runs."""

SUFFIXES = (".yaml", ".yml")


class SceneFileError(ValueError):
    """A scene that is not there or that cannot be read."""


@dataclass(frozen=True)
class SceneFile:
    """Parameters of the nodes.

    Attributes:
        name: What people call it.
        parameters: Parameters by node key, such as `SIMULATION`, and full name, such as
            "tool.grasper.size".
        source: File it was read from; None for a scene made of a mesh.
    """

    name: str
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    source: Path | None = None

    @property
    def simulation(self) -> Mapping[str, Any]:
        """Parameters of the simulation."""
        return self.parameters.get(SIMULATION, {})

    def with_simulation(self, changes: Mapping[str, Any]) -> SceneFile:
        """The same scene with some parameters of the simulation replaced."""
        simulation = {**self.simulation, **changes}
        return replace(self, parameters={**self.parameters, SIMULATION: simulation})

    def write(self, path: Path) -> None:
        """Write it as a ROS parameter file."""
        nodes = {
            node: {"ros__parameters": dict(values)} for node, values in self.parameters.items()
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(yaml.safe_dump(nodes, sort_keys=False), encoding="utf-8")


def config_folder() -> Path:
    """Folder of the scenes that come with the project.

    Raises:
        SceneFileError: It is neither in the source tree nor installed.
    """
    source_tree = Path(__file__).resolve().parents[3] / "config"
    if source_tree.is_dir() and (source_tree.parent / "src").is_dir():
        return source_tree
    if importlib.util.find_spec("ament_index_python"):
        from ament_index_python.packages import (
            PackageNotFoundError,
            get_package_share_directory,
        )

        try:
            return Path(get_package_share_directory("tissue_sim")) / "config"
        except PackageNotFoundError:
            pass
    raise SceneFileError("the folder config/ is not there: is the workspace built and sourced?")


def scene_names() -> list[str]:
    """Names of the scenes that come with the project."""
    return sorted(path.stem for path in config_folder().glob("*.yaml"))


def is_mesh_file(text: str) -> bool:
    """Whether an argument names a mesh file rather than a scene."""
    suffix = Path(text).suffix.lower()
    return bool(suffix) and suffix not in SUFFIXES


def find_scene(text: str) -> SceneFile:
    """A scene by name or by file.

    Raises:
        SceneFileError: There is none, or the file is no ROS parameter file.
    """
    path = Path(text)
    if path.suffix.lower() not in SUFFIXES:
        if text not in scene_names():
            raise SceneFileError(
                f"there is no scene {text!r}; there are {', '.join(scene_names())}, "
                "or give a .yaml file or a mesh file"
            )
        path = config_folder() / f"{text}.yaml"
    return read_scene(path)


def read_scene(path: Path) -> SceneFile:
    """A scene from a ROS parameter file.

    Raises:
        SceneFileError: It cannot be read or is no ROS parameter file.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise SceneFileError(f"{path}: cannot be read: {error}") from None
    except yaml.YAMLError as error:
        raise SceneFileError(f"{path}: no valid YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, dict):
        raise SceneFileError(f"{path}: must map node names to ros__parameters")
    nodes: dict[str, dict[str, Any]] = {}
    for node, body in content.items():
        if not isinstance(body, dict) or set(body) != {"ros__parameters"}:
            raise SceneFileError(f"{path}: {node}: must hold ros__parameters and nothing else")
        nodes[str(node)] = dict(_flat(body["ros__parameters"] or {}))
    if SIMULATION not in nodes:
        raise SceneFileError(f"{path}: has no {SIMULATION}")
    return SceneFile(path.stem, nodes, path.resolve())


def _flat(tree: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Nested parameters by full name, as ROS itself names them."""
    flat: list[tuple[str, Any]] = []
    for key, value in tree.items():
        name = f"{prefix}{key}"
        flat += _flat(value, f"{name}.") if isinstance(value, dict) else [(name, value)]
    return flat
