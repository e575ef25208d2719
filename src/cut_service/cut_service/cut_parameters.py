"""Parameters of the cutting node."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cut_service.planner import METHODS, Settings
from tissue_sim.parameters import Spec

SPECS = (
    Spec("method", "string", METHODS[0], "how to cut when a request does not say", choices=METHODS),
    Spec("snap", "bool", True, "whether the cut's nodes are moved onto the sweep"),
    Spec(
        "quality_floor", "double", 0.1,
        "smallest radius ratio that moving a node may leave its elements with",
        minimum=0.0, maximum=0.5,
    ),
    Spec(
        "crease_angle", "double", 40.0, "surface edges sharper than this are kept",
        "deg", 5.0, 175.0,
    ),
    Spec(
        "volume_budget", "double", 5e-4,
        "largest change of rest volume by one cut, as a share of the organ's",
        minimum=0.0, maximum=1e-3,
    ),
    Spec(
        "smallest_piece", "integer", 5,
        "number of elements below which a piece is not cut free", minimum=1, maximum=100,
    ),
    Spec(
        "vertex_share", "double", 0.15,
        "subdivide: a sweep that passes an edge nearer to its end than this share of it passes "
        "through the end",
        minimum=0.0, maximum=0.45,
    ),
    Spec(
        "vertex_reach", "double", 0.05,
        "subdivide: the same as a share of the organ's mean edge", minimum=0.0, maximum=0.45,
    ),
    Spec(
        "remove_degeneracies", "bool", True,
        "whether elements that snapping or dividing has made flat or short are mended",
    ),
    Spec(
        "wanted_ratio", "double", 0.2,
        "radius ratio below which an element that a cut has made worse is mended",
        minimum=0.01, maximum=0.5,
    ),
    Spec(
        "wanted_length", "double", 0.4,
        "the same of the length of its edges, as a share of the organ's mean edge",
        minimum=0.01, maximum=0.7,
    ),
    Spec("shapes_kept", "integer", 30, "frames a request can name", minimum=1, maximum=600),
    Spec("attempts", "integer", 3, "plans made before a cut fails as stale", minimum=1, maximum=10),
    Spec(
        "answer_timeout", "double", 5.0, "longest wait for the simulation's answer to an edit",
        "s", 0.1, 60.0,
    ),
    Spec(
        "tissue_timeout", "double", 5.0,
        "longest wait for the topology and state a request needs", "s", 0.1, 60.0,
    ),
    Spec(
        "requests_remembered", "integer", 256, "answers kept for repeats",
        minimum=1, maximum=10000,
    ),
)  # fmt: skip


@dataclass(frozen=True)
class CutParameters:
    """What the cutting node can be told; `SPECS` describes each."""

    method: str
    settings: Settings
    shapes_kept: int
    attempts: int
    answer_timeout: float
    tissue_timeout: float
    requests_remembered: int

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> CutParameters:
        """The parameters from their checked values; those of static frames may be among them."""
        own = {spec.name: values[spec.name] for spec in SPECS}
        settings = Settings(
            snap=own.pop("snap"),
            quality_floor=own.pop("quality_floor"),
            crease_angle=float(np.radians(own.pop("crease_angle"))),
            volume_budget=own.pop("volume_budget"),
            smallest_piece=own.pop("smallest_piece"),
            vertex_share=own.pop("vertex_share"),
            vertex_reach=own.pop("vertex_reach"),
            remove_degeneracies=own.pop("remove_degeneracies"),
            wanted_ratio=own.pop("wanted_ratio"),
            wanted_length=own.pop("wanted_length"),
        )
        return cls(settings=settings, **own)
