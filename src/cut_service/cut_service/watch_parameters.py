"""Parameters of what the cutting node does without being asked: tearing and burning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cut_service.burning import BurnSettings
from cut_service.sheet_tearing import SheetTearSettings
from cut_service.tearing import TearSettings
from tissue_sim.parameters import Spec

WATCH_SPECS = (
    Spec(
        "tear.threshold", "double", 0.0,
        "largest principal stress that tetrahedra bear before they tear; 0: they never do",
        "Pa", 0.0, 1e12, live=True,
    ),
    Spec(
        "tear.elongation", "double", 0.0,
        "share of its length by which a spring of a surface stretches before the surface tears; "
        "0: it never does",
        minimum=0.0, maximum=1e3, live=True,
    ),
    Spec(
        "tear.rate_hz", "double", 10.0, "how often tissue is looked at for tears, and most edits",
        "1/s", 0.1, 60.0,
    ),
    Spec(
        "tear.settle", "double", 0.1,
        "time after a change of the topology during which nothing tears, for the stress to settle",
        "s", 0.0, 60.0, live=True,
    ),
    Spec(
        "tear.faces_per_edit", "integer", 24, "faces after which one edit opens no further node",
        minimum=1, maximum=10000, live=True,
    ),
    Spec(
        "tear.pull_share", "double", 0.6,
        "faces open if the mean traction on them is at least this share of the threshold",
        minimum=0.0, maximum=1.0, live=True,
    ),
    Spec(
        "tear.spacing", "double", 6.0,
        "cracks that open in one edit are so many mean edges apart",
        minimum=0.0, maximum=1e6, live=True,
    ),
    Spec("burn.power", "double", 30.0, "of a tool of kind burn", "W", 0.0, 1e6, live=True),
    Spec(
        "burn.energy_density", "double", 2.2e9, "heat that an element takes up before it is gone",
        "J/m^3", 1.0, 1e15, live=True,
    ),
    Spec("burn.rate_hz", "double", 10.0, "most edits by burning", "1/s", 0.1, 60.0),
)  # fmt: skip


@dataclass(frozen=True)
class WatchSettings:
    """What `WATCH_SPECS` say.

    Attributes:
        tear: When tetrahedra tear.
        sheet: When surfaces tear.
        settle: Time after a change of the topology during which nothing tears [s].
        burn: How tissue burns.
    """

    tear: TearSettings
    sheet: SheetTearSettings
    settle: float
    burn: BurnSettings

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> WatchSettings:
        """The settings from checked values by full name."""
        return cls(
            tear=TearSettings(
                threshold=values["tear.threshold"],
                faces_per_edit=values["tear.faces_per_edit"],
                pull_share=values["tear.pull_share"],
                spacing=values["tear.spacing"],
                smallest_piece=values["smallest_piece"],
            ),
            sheet=SheetTearSettings(values["tear.elongation"]),
            settle=values["tear.settle"],
            burn=BurnSettings(values["burn.power"], values["burn.energy_density"]),
        )
