"""What was done to an organ, and how it was measured to move."""

from __future__ import annotations

from dataclasses import dataclass

from tissue_sim.compare.interaction import Interaction, InteractionError
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.trajectory import Trajectory


@dataclass(frozen=True)
class Recording:
    """What was done to an organ, and how it was measured to move if somebody measured.

    Attributes:
        organ: The organ.
        interaction: What was done to it.
        measured: How it moved; None: nobody measured.
        notes: What people should know of it, such as frames that are left out.
        unmeasured: Why there is no measurement; empty: there is one.
    """

    organ: Organ
    interaction: Interaction
    measured: Trajectory | None = None
    notes: tuple[str, ...] = ()
    unmeasured: str = "it holds an interaction only"

    def reference(self) -> Trajectory:
        """The measurement.

        Raises:
            InteractionError: There is none; the message says why.
        """
        if self.measured is None:
            raise InteractionError(
                f"{self.interaction.name} has no measured positions: {self.unmeasured}"
            )
        return self.measured
