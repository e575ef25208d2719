"""Parameters of the simulation's node."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Material, Parameter, RegionMaterial
from tissue_sim.elastic.predictor import MOST_STEPS
from tissue_sim.frames import Frames, frame_specs
from tissue_sim.geometry.regions import region_key
from tissue_sim.geometry.sheet import LARGEST_FACTOR, SheetStiffness
from tissue_sim.geometry.sheet_geometry import (
    CONNECTED,
    KINDS,
    SURFACE,
    THICKEST,
    VOLUME,
    SheetSettings,
)
from tissue_sim.interaction.contact import PARAMETERS as CONTACT
from tissue_sim.interaction.contact import Contact
from tissue_sim.interaction.coupling import HOLDS, POSITION, Coupling
from tissue_sim.interaction.coupling import PARAMETERS as COUPLING
from tissue_sim.interaction.cut_response import PARAMETERS as RESPONSE
from tissue_sim.interaction.cut_response import CutResponse
from tissue_sim.interaction.reaction import ForceLimits
from tissue_sim.interaction.seeding import LARGEST_RADIUS
from tissue_sim.interaction.tools import (
    AT_USE,
    CUTTING,
    LARGEST,
    SHAPES,
    SMALLEST,
    ToolError,
    ToolSpec,
)
from tissue_sim.interaction.tracker import ToolLimits
from tissue_sim.parameters import ParameterError, Spec
from tissue_sim.playback.parameters import PARAMETERS as PLAYBACK
from tissue_sim.scene import Scene

SAME = -1.0
"""Of a region's material: as everywhere else."""

_ALL_SHAPES = tuple(shape for shapes in SHAPES.values() for shape in shapes)

SPECS = (
    Spec("geometry", "string", "wall", "Name of a generated shape, or a mesh file."),
    Spec(
        "units", "string", "", "Unit of the mesh file's coordinates; a shape needs none.",
        choices=("", "m", "mm"),
    ),
    Spec(
        "cell", "double", 0.0, "Element size for filling a surface file; 0: chosen.",
        unit="m", minimum=0.0, maximum=1.0,
    ),
    Spec(
        "geometry_kind", "string", VOLUME,
        "Tetrahedra (a surface file is filled), the triangles of the surface, or triangles joined "
        "through the tissue.",
        choices=KINDS,
    ),
    Spec(
        "surface_thickness", "double", 0.0,
        "Of the tissue that triangles stand for; 0: 2 mm for a surface, half of the tissue's own "
        "for connected surfaces.",
        unit="m", minimum=0.0, maximum=THICKEST,
    ),
    *(
        Spec(f"stiffness.{name}", "double", default, meaning, minimum=low, maximum=LARGEST_FACTOR)
        for name, default, low, meaning in (
            ("surface", 1.0, 1e-6, "Factor of the stiffness of the edges of triangles."),
            ("connecting", 1.0, 1e-6, "Factor of that of springs to the opposite side."),
            ("bending", 0.0, 0.0, "Factor of that of springs across two edges; 0: none."),
            ("angular", 0.0, 0.0, "Factor of that of springs across two triangles; 0: none."),
            ("torsion", SAME, SAME, "Factor of that of torsion springs; 0: none, -1: 1 for a "
                                    "surface, none for connected surfaces."),
        )
    ),
    Spec("fixed", "string", "auto", "Nodes that never move: auto, none, set:NAME, low:z:0.1, ..."),
    Spec("frame_id", "string", "organ", "The organ's frame: of rest positions and of all output."),
    Spec(
        "rate_hz", "double", 60.0, "Published frames per second.",
        unit="1/s", minimum=1.0, maximum=1000.0,
    ),
    Spec(
        "budget_ms", "double", 6.0, "Time for model steps in each frame.",
        unit="ms", minimum=0.1, maximum=1000.0, live=True,
    ),
    Spec(
        "realtime_priority", "integer", 50,
        "Priority of the loop under SCHED_FIFO, where the system allows it; 0: an ordinary thread.",
        minimum=0, maximum=99,
    ),
    Spec(
        "steps_per_frame", "integer", 0, "Exactly so many model steps in each frame; 0: by time.",
        minimum=0, maximum=100000, live=True,
    ),
    Spec("model", "string", "lr", "Elastic model.", choices=tuple(registry.names())),
    Spec(
        "young_modulus", "double", 5e4, "Young's modulus of the tissue.",
        unit="Pa", minimum=1.0, maximum=1e12,
    ),
    Spec(
        "poisson_ratio", "double", 0.45, "Poisson's ratio of the tissue.",
        minimum=0.0, maximum=0.4999,
    ),
    Spec(
        "density", "double", 1060.0, "Mass density of the tissue.",
        unit="kg/m^3", minimum=1.0, maximum=1e5,
    ),
    Spec(
        "fibre_stiffness", "double", 0.0, "What fibres add to the stiffness along them.",
        unit="Pa", minimum=0.0, maximum=1e12,
    ),
    Spec(
        "fibres", "string", "", "How fibres run: none, cell:NAME, along:x,y,z or around:x,y,z.",
    ),
    Spec("regions", "strings", [], "Names of regions made of something else."),
    Spec(
        "seeded_release", "double", 0.0,
        "Distance from released tissue within which it starts from rest, blended; 0: not at all.",
        unit="m", minimum=0.0, maximum=LARGEST_RADIUS,
    ),
    Spec(
        "predictor", "string", "",
        "A fast model whose changes are where the steps of a frame start from; empty: none.",
    ),
    Spec(
        "predictor_steps", "integer", 1, "Steps of the predictor in a frame.",
        minimum=1, maximum=MOST_STEPS,
    ),
    Spec("tools", "strings", [], "Ids of the tools at the start."),
    Spec(
        "max_tool_speed", "double", 0.5, "Fastest a tool that holds tissue is moved.",
        unit="m/s", minimum=1e-4, maximum=100.0, live=True,
    ),
    Spec(
        "max_jump", "double", 0.05,
        "Farthest two poses in a row may lie apart while the tool holds tissue.",
        unit="m", minimum=1e-5, maximum=10.0, live=True,
    ),
    Spec(
        "pose_timeout", "double", 0.2, "An older pose is stale: the tool freezes.",
        unit="s", minimum=0.001, maximum=3600.0, live=True,
    ),
    Spec(
        "release_timeout", "double", 2.0, "With an older pose the tool lets go.",
        unit="s", minimum=0.001, maximum=3600.0, live=True,
    ),
    Spec(
        "max_force", "double", 20.0, "Largest force published for a tool.",
        unit="N", minimum=0.0, maximum=1e4, live=True,
    ),
    Spec(
        "max_torque", "double", 2.0, "Largest torque published for a tool.",
        unit="N m", minimum=0.0, maximum=1e4, live=True,
    ),
    Spec(
        "max_force_rate", "double", 200.0, "Fastest change of the published force.",
        unit="N/s", minimum=0.0, maximum=1e6, live=True,
    ),
    Spec(
        "max_torque_rate", "double", 20.0, "Fastest change of the published torque.",
        unit="N m/s", minimum=0.0, maximum=1e6, live=True,
    ),
    Spec("data_dir", "string", "~/.local/share/tissue_sim", "Folder of saved organs."),
    Spec(
        "wait_for", "strings", [],
        "topic:count of subscribers (publishers where the simulation subscribes) that the clock "
        "waits for before frame 1.",
    ),
    Spec(
        "wait_timeout", "double", 30.0, "Longest wait for them.",
        unit="s", minimum=0.0, maximum=3600.0,
    ),
    Spec("frames", "integer", 0, "Stop after so many frames; 0: run on.", minimum=0, maximum=2**53),
    Spec(
        "seed", "integer", 0, "Makes the first epoch's id repeatable; 0: a new one at each start.",
        minimum=0, maximum=2**53,
    ),
)  # fmt: skip


def tool_specs(tools: Iterable[str]) -> list[Spec]:
    """Parameters of the tools with these ids."""
    specs = []
    for tool in tools:
        base = f"tool.{tool}"
        specs += [
            Spec(f"{base}.kind", "string", "grab", "What it does.", choices=tuple(SHAPES)),
            Spec(f"{base}.shape", "string", "", "Its shape; empty: the first of its kind.",
                 choices=("", *_ALL_SHAPES)),
            Spec(f"{base}.size", "doubles", [0.005],
                 "sphere: radius; box: lengths along x, y, z; capsule: radius, length along z; "
                 "rectangle and triangle: length along x, depth along z.",
                 unit="m", minimum=SMALLEST, maximum=LARGEST),
            Spec(f"{base}.position", "doubles", [0.0, 0.0, 0.0], "Where its tip starts.",
                 unit="m", length=3),
            Spec(f"{base}.orientation", "doubles", [0.0, 0.0, 0.0, 1.0],
                 "How it starts, quaternion x y z w.", length=4),
            Spec(f"{base}.scale", "double", 1.0, "Metres it moves per metre of its source.",
                 minimum=1e-3, maximum=1e3),
            Spec(f"{base}.offset", "doubles", [0.0, 0.0, 0.0],
                 "Added to its source's position, after scaling.", unit="m", length=3),
            Spec(f"{base}.hold", "string", POSITION,
                 "How a grab holds: position puts tissue where the tool is, force pulls it there.",
                 choices=HOLDS),
            *[_number(base, parameter) for parameter in COUPLING],
            Spec(f"{base}.cutting", "string", AT_USE,
                 "How a blade cuts: at_use once where it is pressed, progressive all it passes.",
                 choices=CUTTING),
            *[_number(base, parameter) for parameter in RESPONSE],
            *[_number(base, parameter) for parameter in CONTACT],
            Spec(f"{base}.owner", "string", "scene", "Who set it."),
        ]  # fmt: skip
    return specs


def _number(base: str, parameter: Parameter) -> Spec:
    """A model's or a tool's number as a parameter of the node."""
    return Spec(
        f"{base}.{parameter.name}",
        "integer" if parameter.integer else "double",
        parameter.default,
        parameter.meaning,
        unit=parameter.unit,
        minimum=parameter.minimum,
        maximum=parameter.maximum,
    )


def region_specs(regions: Iterable[str]) -> list[Spec]:
    """Parameters of the regions with these names."""
    specs = []
    for region in regions:
        base = f"region.{region}"
        specs += [
            Spec(f"{base}.where", "string", "",
                 "name:NAME, label:NUMBER, sphere:x,y,z,r or box:x0,x1,y0,y1,z0,z1; empty: name."),
            Spec(f"{base}.young_modulus", "double", SAME, "Its Young's modulus; -1: the tissue's.",
                 unit="Pa", minimum=SAME, maximum=1e12),
            Spec(f"{base}.poisson_ratio", "double", SAME, "Its Poisson's ratio; -1: the tissue's.",
                 minimum=SAME, maximum=0.4999),
            Spec(f"{base}.density", "double", SAME, "Its mass density; -1: the tissue's.",
                 unit="kg/m^3", minimum=SAME, maximum=1e5),
            Spec(f"{base}.fibre_stiffness", "double", SAME,
                 "What its fibres add to the stiffness along them; -1: the tissue's.",
                 unit="Pa", minimum=SAME, maximum=1e12),
        ]  # fmt: skip
    return specs


def model_specs() -> list[Spec]:
    """Parameters `<model>.<parameter>` of every model."""
    return [
        _number(model, parameter)
        for model in registry.names()
        for parameter in registry.parameters_of(model)
    ]


def shape_specs(names: Iterable[str]) -> list[Spec]:
    """Parameters `shape.<name>` of the generated shape; their defaults are the shape's own."""
    return [
        Spec(f"shape.{name}", "double", 0.0, f"Parameter {name} of the generated shape.")
        for name in names
    ]


def specs(given: Mapping[str, Any]) -> list[Spec]:
    """Every parameter of a node that was given these; tools, frames and shapes come in families.

    Raises:
        ParameterError: The list of tools is not one.
    """
    table = {spec.name: spec for spec in SPECS}
    tools = _unrepeated(table["tools"], given)
    frames = {key.split(".")[1] for key in given if key.startswith("frames.") and "." in key[7:]}
    shapes = [key.split(".", 1)[1] for key in given if key.startswith("shape.")]
    return [
        *SPECS,
        *tool_specs(tools),
        *region_specs(_unrepeated(table["regions"], given)),
        *model_specs(),
        *frame_specs(sorted(frames)),
        *shape_specs(shapes),
        *PLAYBACK,
    ]


def _unrepeated(spec: Spec, given: Mapping[str, Any]) -> list[str]:
    """The names a list of names holds.

    Raises:
        ParameterError: It is no such list, or names something twice.
    """
    names: list[str] = spec.checked(given.get(spec.name) or [])
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ParameterError(f"{spec.name} names {', '.join(repeated)} twice; ids are unique")
    return names


@dataclass(frozen=True)
class Settings:
    """What the parameters mean, checked.

    Attributes:
        scene: Model, material, tools and rate.
        frames: Static frames.
        limits: What sources of tool motion may do.
        force_limits: What is published of forces.
        budget: Time for model steps in each frame [s].
        steps_per_frame: Model steps in each frame; 0: by time.
        data_dir: Folder of saved organs.
        wait_for: Topics and how many must be matched before the clock starts.
        shape: Parameters of the generated shape.
        regions: Where regions lie, by name.
        sheet: How the surface becomes tissue; None: the tissue is made of tetrahedra.
    """

    scene: Scene
    frames: Frames
    limits: ToolLimits
    force_limits: ForceLimits
    budget: float
    steps_per_frame: int
    data_dir: Path
    wait_for: Mapping[str, int]
    shape: Mapping[str, float]
    regions: Mapping[str, str]
    sheet: SheetSettings | None

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Settings:
        """Settings from checked values by full name.

        Raises:
            ValueError: Values do not go together.
        """
        limits = tool_limits(values)
        return cls(
            scene=Scene(
                model=values["model"],
                parameters=_model_parameters(values),
                material=_material(values),
                tools=tuple(_tool(values, tool) for tool in values["tools"]),
                rate_hz=values["rate_hz"],
                seeded_release=values["seeded_release"],
                predictor=values["predictor"],
                predictor_steps=values["predictor_steps"],
            ),
            frames=Frames.from_parameters(values["frame_id"], values),
            limits=limits,
            force_limits=force_limits(values),
            budget=values["budget_ms"] / 1000.0,
            steps_per_frame=values["steps_per_frame"],
            data_dir=Path(values["data_dir"]).expanduser(),
            wait_for=dict(_wait_for(entry) for entry in values["wait_for"]),
            shape=shape_of(values),
            regions={name: values[f"region.{name}.where"] for name in values["regions"]},
            sheet=sheet_settings(values),
        )


def _material(values: Mapping[str, Any]) -> Material:
    names = ("young_modulus", "poisson_ratio", "density", "fibre_stiffness")

    def part(region: str) -> RegionMaterial:
        base = f"region.{region}"
        given = {name: values[f"{base}.{name}"] for name in names}
        wrong = [name for name, value in given.items() if SAME < value < 0.0]
        if wrong:
            raise ParameterError(
                f"parameter {base}.{wrong[0]} = {given[wrong[0]]:g} is not allowed; allowed: at "
                "least 0, or -1 for what it is everywhere else"
            )
        own = {n: values[n] if value == SAME else value for n, value in given.items()}
        return RegionMaterial(region_key(region, values[f"{base}.where"]), **own)

    regions = tuple(part(region) for region in values["regions"])
    return Material(**{name: values[name] for name in names}, regions=regions)


def sheet_settings(values: Mapping[str, Any]) -> SheetSettings | None:
    """How the surface becomes tissue; None: the tissue is made of tetrahedra.

    Args:
        values: Parameters by name; defaults for those left out.

    Raises:
        ValueError: A value is out of range, or given for tetrahedra.
    """
    table = {spec.name: spec for spec in SPECS}
    factors = [name for name in table if name.startswith("stiffness.")]
    names = ["geometry_kind", "surface_thickness", *factors]
    given = {name: table[name].checked(values.get(name, table[name].default)) for name in names}
    kind = given["geometry_kind"]
    if kind == VOLUME:
        for name in names[1:]:
            if given[name] != table[name].default:
                raise ParameterError(
                    f"{name} is for geometry_kind {SURFACE} or {CONNECTED}, which is {kind}"
                )
        return None
    stiffness = {name.split(".")[1]: given[name] for name in factors}
    if stiffness["torsion"] == SAME:
        stiffness["torsion"] = 1.0 if kind == SURFACE else 0.0
    settings = SheetSettings(kind, given["surface_thickness"], SheetStiffness(**stiffness))
    return settings.checked()


def tool_limits(values: Mapping[str, Any]) -> ToolLimits:
    """Limits of tools' sources.

    Raises:
        ParameterError: A tool would let go before it freezes.
    """
    if values["release_timeout"] < values["pose_timeout"]:
        raise ParameterError(
            f"release_timeout = {values['release_timeout']:g} s is shorter than pose_timeout = "
            f"{values['pose_timeout']:g} s; a tool freezes first and lets go later"
        )
    names = ("max_tool_speed", "max_jump", "pose_timeout", "release_timeout")
    return ToolLimits(**{name: values[name] for name in names})


def force_limits(values: Mapping[str, Any]) -> ForceLimits:
    """Limits of published forces."""
    names = ("max_force", "max_torque", "max_force_rate", "max_torque_rate")
    return ForceLimits(**{name: values[name] for name in names})


def _model_parameters(values: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    return {
        model: {
            parameter.name: float(values[f"{model}.{parameter.name}"])
            for parameter in registry.parameters_of(model)
        }
        for model in registry.names()
    }


def _tool(values: Mapping[str, Any], tool: str) -> ToolSpec:
    base = f"tool.{tool}"
    kind = values[f"{base}.kind"]
    spec = ToolSpec(
        id=tool,
        kind=kind,
        shape=values[f"{base}.shape"] or SHAPES[kind][0],
        size=tuple(values[f"{base}.size"]),
        pose=(*values[f"{base}.position"], *values[f"{base}.orientation"]),
        owner=values[f"{base}.owner"],
        scale=values[f"{base}.scale"],
        offset=tuple(values[f"{base}.offset"]),
        hold=values[f"{base}.hold"],
        coupling=Coupling(**{item.name: values[f"{base}.{item.name}"] for item in COUPLING}),
        cutting=values[f"{base}.cutting"],
        response=CutResponse(**{item.name: values[f"{base}.{item.name}"] for item in RESPONSE}),
        contact=Contact(**{item.name: values[f"{base}.{item.name}"] for item in CONTACT}),
    )
    try:
        return spec.checked()
    except ToolError as error:
        raise ParameterError(str(error)) from None


def _wait_for(entry: str) -> tuple[str, int]:
    topic, _, count = entry.rpartition(":")
    if not topic or not count.isdigit() or int(count) < 1:
        raise ParameterError(f"wait_for item {entry!r} is not allowed; allowed: topic:count")
    return topic, int(count)


def shape_of(values: Mapping[str, Any]) -> dict[str, float]:
    """Parameters of the generated shape that were given, without their `shape.`."""
    return {
        key.removeprefix("shape."): _whole(value)
        for key, value in values.items()
        if key.startswith("shape.")
    }


def _whole(value: float) -> float:
    """Numbers of nodes are given as numbers like all others."""
    return int(value) if value == int(value) else value
