"""What the haptic node says about its loop."""

from __future__ import annotations

import time

from tissue_sim.diagnostics import OK, WARN, Finding
from tissue_sim.realtime import FixedRate, Window
from tool_input.haptics.contact_loop import ContactLoop

SLOW = 500.0
"""Below this rate a stiff contact is felt as rough [1/s]."""

INTERVAL = 1.0
"""Time in which rates are counted [s]."""


class LoopAccount:
    """Counts ticks, for diagnostics.

    Attributes:
        tick_ms: Times of ticks [ms].
        models: Contact models received.
        refusal: Why the last model that could not be used could not; empty: all could.
    """

    def __init__(self, rate: FixedRate) -> None:
        """Count the ticks of a rate."""
        self.tick_ms = Window()
        self.models, self.refusal = 0, ""
        self._rate = rate
        self._at, self._ticks, self._models = time.perf_counter(), 0, 0
        self._achieved, self._heard = 1.0 / rate.period, 0.0

    def findings(self, now: float, loop: ContactLoop) -> list[Finding]:
        """Findings, with the rates of the last second.

        Args:
            now: Steady time [s].
            loop: Whose force it is.
        """
        elapsed = now - self._at
        if elapsed > INTERVAL:
            self._achieved = (self.tick_ms.count - self._ticks) / elapsed
            self._heard = (self.models - self._models) / elapsed
            self._at, self._ticks, self._models = now, self.tick_ms.count, self.models
        achieved = self._achieved
        median, most = self.tick_ms.quantiles(0.5, 0.99)
        ticking = Finding(
            "loop",
            OK if achieved >= min(SLOW, 0.9 / self._rate.period) else WARN,
            f"{achieved:.0f} of {1.0 / self._rate.period:g} forces/s",
            {
                "achieved_rate_hz": f"{achieved:.1f}",
                "ticks": str(self.tick_ms.count),
                "late_ticks": str(self._rate.late),
                "skipped_ticks": str(self._rate.skipped),
                "tick_ms_p50": f"{median:.4f}",
                "tick_ms_p99": f"{most:.4f}",
                "models_per_second": f"{self._heard:.1f}",
            },
        )
        passivity = loop.passivity
        message = f"no force: {loop.withheld}" if loop.withheld else "force is given"
        if self.refusal:
            message += f"; a contact model was refused: {self.refusal}"
        given = Finding(
            "force",
            WARN if loop.withheld or self.refusal else OK,
            message,
            {
                "share": f"{loop.share:.3f}",
                "energy_J": f"{passivity.energy:.6g}",
                "energy_lowest_J": f"{passivity.lowest:.6g}",
                "energy_dissipated_J": f"{passivity.dissipated:.6g}",
                "corrected_ticks": str(passivity.corrections),
                "models_scaled_down": str(loop.scaled_down),
            },
        )
        return [ticking, given]
