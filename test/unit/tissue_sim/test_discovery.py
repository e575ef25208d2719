"""Nothing leaves this machine unless the user chose so: by node and by shell."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tissue_sim.discovery import DISCOVERY_VARIABLES, THIS_MACHINE, local


def sourced(repository: Path, chosen: dict[str, str]) -> dict[str, str]:
    """Discovery variables after scripts/env.sh, for a user who chose some."""
    kept = {name: value for name, value in os.environ.items() if name not in DISCOVERY_VARIABLES}
    shown = subprocess.run(
        ["bash", "-c", ". scripts/env.sh; env -0"],
        cwd=repository, env=kept | chosen, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    after = dict(line.partition("=")[::2] for line in shown.split("\0") if line)
    return {name: after[name] for name in DISCOVERY_VARIABLES if name in after}


def test_the_shell_chooses_what_a_node_would(repository: Path) -> None:
    by_shell, by_node = sourced(repository, {}), local({})
    profile = "FASTRTPS_DEFAULT_PROFILES_FILE"
    assert by_shell.keys() == by_node.keys()
    assert Path(by_shell.pop(profile)).read_text() == Path(by_node.pop(profile)).read_text()
    assert by_shell == by_node


@pytest.mark.parametrize("name", DISCOVERY_VARIABLES)
def test_a_choice_of_the_user_is_left_alone(repository: Path, name: str) -> None:
    assert local({name: "chosen"}) == {}
    assert sourced(repository, {name: "chosen"}) == {name: "chosen"}


def test_another_middleware_gets_the_range_it_knows() -> None:
    chosen = local({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"})
    assert chosen == {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def test_the_profile_names_no_interface_but_the_loopback() -> None:
    profile = ElementTree.parse(THIS_MACHINE)
    addresses = [e.text for e in profile.iter() if e.tag.endswith("}address")]
    assert addresses == ["127.0.0.1", "127.0.0.1"]
