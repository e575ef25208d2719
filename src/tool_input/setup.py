"""Installs tool_input where colcon says; name, version and licence are those of package.xml."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

PACKAGE_ROOT = Path(__file__).resolve().parent
MANIFEST = ElementTree.parse(PACKAGE_ROOT / "package.xml")


def manifest(tag: str) -> str:
    """Text of one of the manifest's top-level tags."""
    return MANIFEST.findtext(tag, "").strip()


def files(folder: str, pattern: str) -> list[str]:
    """The files to install from a folder that need not exist, relative to this one."""
    return sorted(f"{folder}/{path.name}" for path in (PACKAGE_ROOT / folder).glob(pattern))


PACKAGE = manifest("name")
SHARE = f"share/{PACKAGE}"

setup(
    name=PACKAGE,
    version=manifest("version"),
    description=manifest("description"),
    maintainer=manifest("maintainer"),
    maintainer_email=MANIFEST.find("maintainer").attrib["email"],
    license=manifest("license"),
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed", "data/**"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/launch", files("launch", "*.launch.py")),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "script_node = tool_input.script_node:main",
            "replay_node = tool_input.replay_node:main",
            "table_node = tool_input.table_node:main",
            "crtk_node = tool_input.crtk_node:main",
            "joy_node = tool_input.joy_node:main",
            "haptic_node = tool_input.haptic_node:main",
            "virtual_arm_node = tool_input.virtual_arm_node:main",
        ],
    },
)
