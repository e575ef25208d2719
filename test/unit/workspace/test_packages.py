"""Manifests, entry points, launch files and requirements agree with each other."""

from __future__ import annotations

import ast
import re
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from support.workspace import (
    PYTHON_PACKAGES,
    REPOSITORY,
    SOURCES,
    declared_parameters,
    dependencies,
    entry_points,
    imported,
    manifest,
    modules,
    syntax,
)

# From the name in an import to its rosdep key; None where rosdep knows none and a comment in
# package.xml says what to install instead.
ROSDEP_KEYS = {
    "cma": None,
    "distributed": None,
    "llvmlite": None,
    "lz4": None,
    "matplotlib": "python3-matplotlib",
    "meshio": "python3-meshio",
    "mujoco": None,
    "newton": None,
    "mcap": "mcap-ros2-support",
    "mcap_ros2": "mcap-ros2-support",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "playwright": None,
    "plotly": None,
    "psutil": "python3-psutil",
    "pybullet": None,
    "pyvista": "python3-pyvista-pip",
    "rerun": None,
    "rerun_cli": None,
    "rich": "python3-rich",
    "scipy": "python3-scipy",
    "trimesh": "python3-trimesh-pip",
    "typer": "python3-typer",
    "viser": None,
    "warp": None,
    "websockets": "python3-websockets",
    "yaml": "python3-yaml",
    "zstandard": None,
}
# From the name in an import to the name on PyPI, where they differ.
DISTRIBUTIONS = {
    "mcap_ros2": "mcap-ros2-support",
    "rerun": "rerun-sdk",
    "rerun_cli": "rerun-sdk",
    "warp": "warp-lang",
    "yaml": "pyyaml",
}
# Of the optional extra `requirements-bench.in`; never imported before use.
OPTIONAL = {"mujoco", "newton", "pybullet", "warp"}
# Of `requirements-dev.in`: tests and studies import them when they are used.
DEVELOPMENT = {"playwright"}


def foreign_imports(package: str) -> set[str]:
    """Top-level names that a package imports from outside itself and the standard library."""
    names = {
        name.partition(".")[0]
        for module in modules().values()
        if module.package == package
        for name in imported(module)
    }
    return names - set(sys.stdlib_module_names) - {package, ""}


def is_ros_package(name: str) -> bool:
    return name in (
        *PYTHON_PACKAGES,
        "rclpy",
        "ament_index_python",
        "rosidl_runtime_py",
    ) or name.endswith(("_msgs", "_srvs", "_interfaces"))


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_manifest_names_every_package_that_the_sources_import(package: str) -> None:
    known = dependencies(package)
    text = (SOURCES / package / "package.xml").read_text()
    comments = " ".join(re.findall(r"<!--(.*?)-->", text, re.DOTALL))
    for name in sorted(foreign_imports(package)):
        if is_ros_package(name):
            # The command starts what depends on its package: rosdep allows no circle.
            started = package == "tissue_sim" and name in PYTHON_PACKAGES and name in comments
            assert name in known or started, name
            continue
        assert name in ROSDEP_KEYS, f"{package} imports {name}: add it to package.xml and here"
        key = ROSDEP_KEYS[name]
        assert key in known if key else DISTRIBUTIONS.get(name, name) in comments, name


def test_packages_depend_on_each_other_in_no_circle() -> None:
    order = TopologicalSorter({name: dependencies(name) for name in PYTHON_PACKAGES})
    order.prepare()


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_requirements_name_every_library_that_the_sources_import(package: str) -> None:
    for name in sorted(foreign_imports(package)):
        if not is_ros_package(name):
            source = "requirements-bench.in" if name in OPTIONAL else "requirements.in"
            source = "requirements-dev.in" if name in DEVELOPMENT else source
            text = (REPOSITORY / source).read_text().lower()
            required = set(re.findall(r"^[a-z0-9-]+", text, re.MULTILINE))
            assert DISTRIBUTIONS.get(name, name) in required


@pytest.mark.parametrize("executable", sorted(entry_points()), ids="/".join)
def test_entry_point_leads_to_a_function(executable: tuple[str, str]) -> None:
    name, function = entry_points()[executable]
    module = modules()[name]
    assert module.package == executable[0]
    bound = {
        node.name for node in syntax(module.path).body if isinstance(node, ast.FunctionDef)
    } | {
        alias.asname or alias.name
        for node in syntax(module.path).body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert function in bound


def test_every_node_has_an_entry_point() -> None:
    nodes = {name for name in modules() if name.endswith("_node")}
    assert nodes <= {module for module, _ in entry_points().values()}


def test_all_packages_have_one_version_and_licence() -> None:
    manifests = [manifest(path.parent.name) for path in SOURCES.glob("*/package.xml")]
    assert len(manifests) == len(PYTHON_PACKAGES) + 1
    assert len({root.findtext("version") for root in manifests}) == 1
    assert {root.findtext("license") for root in manifests} == {"Apache-2.0"}


LAUNCH_FILES = sorted(SOURCES.glob("*/launch/*.launch.py"))


def launched_nodes(path: Path) -> list[dict[str, ast.expr]]:
    """Keyword arguments of each `Node(...)` in a launch file."""
    return [
        {keyword.arg: keyword.value for keyword in node.keywords if keyword.arg}
        for node in ast.walk(syntax(path))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Node"
    ]


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_launch_file_starts_nodes_that_exist_with_parameters_that_they_declare(path: Path) -> None:
    nodes = launched_nodes(path)
    assert nodes, "a launch file starts nodes, with Node(package=..., executable=...)"
    for node in nodes:
        executable = (ast.literal_eval(node["package"]), ast.literal_eval(node["executable"]))
        assert executable in entry_points(), executable
        declared = declared_parameters(entry_points()[executable][0])
        parameters = node.get("parameters", ast.List([], ast.Load()))
        for dictionary in ast.walk(parameters):
            if isinstance(dictionary, ast.Dict):
                for key in dictionary.keys:
                    assert isinstance(key, ast.Constant), "parameter names are written out"
                    name = str(key.value)
                    known = name == "use_sim_time" or any(p.fullmatch(name) for p in declared)
                    assert known, f"{executable} declares no parameter {name}"
