"""Couplings of tools: what is allowed, what is kept, and the force within the limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tissue_interfaces.msg import Tool

from support.small_block import pose_of
from tissue_sim import conversions
from tissue_sim.interaction.coupling import PARAMETERS, Coupling
from tissue_sim.interaction.tools import ToolError, ToolSpec
from tissue_sim.parameters import ParameterError, refuse_unknown
from tissue_sim.simulation_parameters import Settings, specs


def settings_of(**given: Any) -> Settings:
    """Settings of a scene file with these parameters of a tool named a."""
    values = {"tools": ["a"], **{f"tool.a.{name}": value for name, value in given.items()}}
    table = specs(values)
    refuse_unknown(values, [spec.name for spec in table])
    return Settings.of({s.name: s.checked(values.get(s.name, s.default)) for s in table})


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda parameter: parameter.name)
def test_numbers_out_of_range_are_refused_with_their_limits(parameter: Any) -> None:
    name, low, high = parameter.name, parameter.minimum, parameter.maximum
    for wrong in (low - 1e-9 - 1e-3 * abs(low), 1.001 * high, np.nan, np.inf, -np.inf):
        with pytest.raises(ToolError, match=f"tool a: {name} = .* allowed: {low:g} to"):
            ToolSpec("a", coupling=Coupling(**{name: float(wrong)})).checked()
        with pytest.raises(ParameterError, match=f"tool.a.{name} = .* from {low:g} to"):
            settings_of(**{name: float(wrong)})
    for right in (low, high, parameter.default):
        ToolSpec("a", coupling=Coupling(**{name: right})).checked()


def test_misspelt_words_are_refused_with_those_that_are_meant() -> None:
    with pytest.raises(ToolError, match=r"hold 'gently' is not allowed; allowed: position, force"):
        ToolSpec("a", hold="gently").checked()
    with pytest.raises(ParameterError, match=r"tool.a.hold = 'gently' .* position, force"):
        settings_of(hold="gently")
    with pytest.raises(ParameterError, match=r"stifness \(did you mean tool.a.stiffness\?\)"):
        settings_of(stifness=100.0)
    arguments = {**ToolSpec("a").as_arguments(), "coupling": {"stifness": 100.0}}
    with pytest.raises(ToolError, match="tool a: unknown stifness; allowed: stiffness, damping"):
        ToolSpec.from_arguments(arguments)


def test_a_scene_file_sets_a_coupling() -> None:
    (tool,) = settings_of(hold="force", stiffness=800, torque_limit=0.5).scene.tools
    assert tool.hold == "force"
    assert tool.coupling == Coupling(stiffness=800.0, torque_limit=0.5)
    assert settings_of().scene.tools[0] == ToolSpec("a")


def test_defaults_are_the_same_in_scene_files_messages_and_the_library() -> None:
    defaults = {parameter.name: parameter.default for parameter in PARAMETERS}
    assert Coupling().as_arguments() == defaults
    message = Tool()
    assert {name: getattr(message, name) for name in defaults} == defaults


def test_a_message_carries_a_coupling_and_an_empty_word_leaves_it() -> None:
    message = Tool(id="a", kind="grab", shape="sphere", hold=Tool.FORCE, stiffness=70.0)
    message.size.append(0.01)
    tool = ToolSpec.from_arguments(conversions.tool_arguments(message))
    assert (tool.hold, tool.coupling) == ("force", Coupling(stiffness=70.0))
    assert ToolSpec.from_arguments(tool.as_arguments()) == tool
    message.hold = ""
    assert not {"hold", "coupling"} & set(conversions.tool_arguments(message))


def test_the_spring_pulls_the_tool_to_the_patch_within_its_limits() -> None:
    coupling = Coupling(stiffness=100.0, angular_stiffness=2.0, force_limit=3.0, torque_limit=0.4)
    tool, half = pose_of([0.1, 0.0, 0.0]), 0.05
    about_y = [0.0, np.sin(half), 0.0, np.cos(half)]
    near = coupling.wrench_on_tool(tool, pose_of([0.1, 0.0, -0.02], about_y))
    np.testing.assert_allclose(near, [0, 0, -2.0, 0, 0.2, 0], atol=1e-12)
    about_y = [0.0, np.sin(0.5), 0.0, np.cos(0.5)]
    far = coupling.wrench_on_tool(tool, pose_of([0.1, 0.0, -0.2], about_y))
    np.testing.assert_allclose(far, [0, 0, -3.0, 0, 0.4, 0], atol=1e-12)
