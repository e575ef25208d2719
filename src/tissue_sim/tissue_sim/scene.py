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
        displacement: Displacement from rest at the start [m], float32, shape (node_rows, 3); None:
            at rest.
    """

    model: str = "lr"
    parameters: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    material: Material = field(default_factory=Material)
    tools: tuple[ToolSpec, ...] = ()
    rate_hz: float = 60.0
    seeded_release: float = 0.0
    displacement: NDArray[np.float32] | None = None

    def as_arguments(self) -> dict[str, Any]:
        """The arguments of a `start` command; plain JSON values."""
        arguments: dict[str, Any] = {
            "model": self.model,
            "parameters": {model: dict(values) for model, values in self.parameters.items()},
            "material": asdict(self.material),
            "tools": [tool.as_arguments() for tool in self.tools],
            "rate_hz": self.rate_hz,
            "seeded_release": self.seeded_release,
        }
        if self.displacement is not None:
            raw = np.ascontiguousarray(self.displacement, dtype="<f4").tobytes()
            arguments["displacement"] = base64.b64encode(zlib.compress(raw, 1)).decode("ascii")
        return arguments

    @classmethod
    def from_arguments(cls, arguments: Mapping[str, Any]) -> Scene:
        """The scene of a `start` command."""
        displacement = None
        if "displacement" in arguments:
            raw = zlib.decompress(base64.b64decode(arguments["displacement"]))
            displacement = np.frombuffer(raw, dtype="<f4").reshape(-1, 3)
        return cls(
            model=arguments["model"],
            parameters=arguments["parameters"],
            material=Material(**arguments["material"]),
            tools=tuple(ToolSpec.from_arguments(tool) for tool in arguments["tools"]),
            rate_hz=float(arguments["rate_hz"]),
            # Journals from before there was seeding do not have it.
            seeded_release=float(arguments.get("seeded_release", 0.0)),
            displacement=displacement,
        )
