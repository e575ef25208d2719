"""Whether a device still speaks, and what it said that could not be used."""

from __future__ import annotations

from tissue_sim.diagnostics import OK, WARN, Finding


class InputWatch:
    """Counts the messages of a device and notices when there are no more.

    Attributes:
        topic: Where they come.
        timeout: Silence after which a device counts as unplugged [s].
        received: Messages that could be used.
        refused: Messages that could not, and why the last one could not.
        fresh: Whether a message that could be used came within the timeout.
        losses: How often it fell silent.
    """

    def __init__(self, topic: str, timeout: float) -> None:
        self.topic, self.timeout = topic, timeout
        self.received = self.refused = self.losses = 0
        self.refusal = ""
        self.fresh = False
        self._last = 0.0

    def accept(self, now: float) -> bool:
        """Count a message that could be used; whether it is the first one after silence.

        Args:
            now: Steady time [s].
        """
        resumed, self.fresh = not self.fresh, True
        self.received += 1
        self._last = now
        return resumed

    def refuse(self, reason: str) -> None:
        """Count a message that could not be used; it does not break the silence."""
        self.refused += 1
        self.refusal = reason

    def lost(self, now: float) -> bool:
        """Whether the device has just fallen silent.

        Args:
            now: Steady time [s].
        """
        if not self.fresh or now - self._last <= self.timeout:
            return False
        self.fresh = False
        self.losses += 1
        return True

    @property
    def silence(self) -> str:
        """What the silence of the device means, for a person."""
        return (
            f"no input on {self.topic} for more than {self.timeout:g} s: no poses are published, "
            "the simulation freezes what it drives and lets go of the tissue"
        )

    def finding(self) -> Finding:
        """What diagnostics say about the device."""
        if self.fresh:
            message = "input"
        elif self.received:
            message = self.silence
        else:
            message = f"no input on {self.topic} yet"
        if self.refusal:
            message += f"; {self.refused} messages refused, the last one because {self.refusal}"
        return Finding(
            "input",
            OK if self.fresh and not self.refused else WARN,
            message,
            {
                "topic": self.topic,
                "messages_received": str(self.received),
                "messages_refused": str(self.refused),
                "losses": str(self.losses),
            },
        )
