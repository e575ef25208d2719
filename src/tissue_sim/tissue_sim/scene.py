"""What a simulation starts with, besides the mesh; session files: see scene_file."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Material
from tissue_sim.interaction.tools import ToolSpec


@dataclass(frozen=True)
class Scene:
    """Everything but the mesh that an epoch starts with; the `start` command of the journal.

    Attributes:
        model: Name of the elastic model.
        parameters: Configured parameters of every model that differ from the defaults, by model.
        material: What the tissue is made of.
        tools: Tools at the start.
        rate_hz: Frames per simulated second [1/s].
        seeded_release: Distance from released nodes within which tissue starts from rest, blended
            [m]; 0: it starts from where it is.
        predictor: Name of a fast model whose changes are where the steps of a frame start from;
            "": none.
        predictor_steps: Its steps in a frame.
        fibres: Unit vector along the fibres of each element, zero where it has none, float32, shape
            (element_rows, 3); None: as the mesh says.
        displacement: Displacement from rest at the start [m], float32, shape (node_rows, 3); None:
            at rest.
    """

    model: str = "lr"
    parameters: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    material: Material = field(default_factory=Material)
    tools: tuple[ToolSpec, ...] = ()
    rate_hz: float = 60.0
    seeded_release: float = 0.0
    predictor: str = ""
    predictor_steps: int = 1
    fibres: NDArray[np.float32] | None = None
    displacement: NDArray[np.float32] | None = None

    def as_arguments(self) -> dict[str, Any]:
        """The arguments of a `start` command; plain JSON values."""
        regions = [asdict(region) for region in self.material.regions]
        arguments: dict[str, Any] = {
            "model": self.model,
            "parameters": {model: dict(values) for model, values in self.parameters.items()},
            "material": {**asdict(self.material), "regions": regions},
            "tools": [tool.as_arguments() for tool in self.tools],
            "rate_hz": self.rate_hz,
            "seeded_release": self.seeded_release,
            "predictor": self.predictor,
            "predictor_steps": self.predictor_steps,
        }
        if self.displacement is not None:
            arguments["displacement"] = _packed(self.displacement)
        if self.fibres is not None:
            arguments["fibres"] = _packed(self.fibres)
        return arguments

    @classmethod
    def from_arguments(cls, arguments: Mapping[str, Any]) -> Scene:
        """The scene of a `start` command."""
        return cls(
            model=arguments["model"],
            parameters=arguments["parameters"],
            material=Material.from_arguments(arguments["material"]),
            tools=tuple(ToolSpec.from_arguments(tool) for tool in arguments["tools"]),
            rate_hz=float(arguments["rate_hz"]),
            # Journals from before there were seeding and prediction do not have them.
            seeded_release=float(arguments.get("seeded_release", 0.0)),
            predictor=str(arguments.get("predictor", "")),
            predictor_steps=int(arguments.get("predictor_steps", 1)),
            fibres=_unpacked(arguments, "fibres"),
            displacement=_unpacked(arguments, "displacement"),
        )


def _packed(vectors: NDArray[np.float32]) -> str:
    raw = np.ascontiguousarray(vectors, dtype="<f4").tobytes()
    return base64.b64encode(zlib.compress(raw, 1)).decode("ascii")


def _unpacked(arguments: Mapping[str, Any], name: str) -> NDArray[np.float32] | None:
    if name not in arguments:
        return None
    raw = zlib.decompress(base64.b64decode(arguments[name]))
    return np.frombuffer(raw, dtype="<f4").reshape(-1, 3)
