"""What the simulation says about itself once a second."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from tissue_sim.frame import Frame
from tissue_sim.interaction.tracker import FROZEN, ToolTracker
from tissue_sim.realtime import FixedRate, Window

OK, WARN, ERROR = 0, 1, 2


@dataclass(frozen=True)
class Finding:
    """One entry of /diagnostics.

    Attributes:
        name: What it is about.
        level: OK, WARN or ERROR.
        message: What a person should know.
        values: Figures by name.
    """

    name: str
    level: int
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


class LoopStatistics:
    """What the loop counted; written by the loop thread, read once a second.

    Attributes:
        step_ms: Times of model steps [ms].
        frame_ms: Times from the frame's start to its publication [ms].
        publish_ms: Times to publish [ms].
        stood: Deadlines at which there was nothing to show: a recording is paused, or slow.
        residual: Distance from equilibrium [N], nan where it has no meaning.
        components: Connected parts of the organ; 0: not counted yet.
        sutures: Stitches that are there.
        suture_forces: Sum of their pulls and the largest of them [N].
    """

    def __init__(self) -> None:
        self.step_ms, self.frame_ms, self.publish_ms = Window(), Window(600), Window(600)
        self.frames = self.steps = self.lost_states = self.stood = 0
        self.residual = float("nan")
        self.components = 0
        self.sutures = 0
        self.suture_forces = (0.0, 0.0)
        self.lost = ""
        self._sim_time = self._sim_time_before = 0.0
        self._at = 0.0
        self._frames_before = self._steps_before = self._lost_before = self._late_before = 0
        self._stood_before = 0

    def add(self, frame: Frame, frame_seconds: float, publish_seconds: float) -> None:
        """Count a published frame."""
        self.frames += 1
        self.steps += len(frame.step_seconds)
        self.step_ms.extend(1e3 * frame.step_seconds)
        self.frame_ms.add(1e3 * frame_seconds)
        self.publish_ms.add(1e3 * publish_seconds)
        self._sim_time = frame.journal.sim_time
        if frame.lost:
            self.lost_states += 1
            self.lost = frame.lost

    def report(self, rate: FixedRate, now: float, paused: bool, model: str) -> list[Finding]:
        """Findings about the time since the last report; then begin a new interval.

        Args:
            rate: The loop's deadlines.
            now: Steady time [s].
            paused: Whether time stands still.
            model: Name of the model.
        """
        elapsed = max(now - self._at, 1e-9) if self._at else 0.0
        frames, steps = self.frames - self._frames_before, self.steps - self._steps_before
        late, lost = rate.late - self._late_before, self.lost_states - self._lost_before
        simulated = self._sim_time - self._sim_time_before
        stood, self._stood_before = self.stood - self._stood_before, self.stood
        achieved = (frames + stood) / elapsed if elapsed else 0.0
        factor = simulated / elapsed if elapsed and simulated >= 0 else 0.0
        self._at, self._frames_before, self._steps_before = now, self.frames, self.steps
        self._late_before, self._lost_before = rate.late, self.lost_states
        self._sim_time_before = self._sim_time
        p50, p99, longest = self.step_ms.quantiles(0.5, 0.99, 1.0)
        _, frame_p99, frame_longest = self.frame_ms.quantiles(0.5, 0.99, 1.0)
        wanted = 1.0 / rate.period
        slow = bool(elapsed) and achieved < 0.95 * wanted
        loop = Finding(
            "loop",
            WARN if slow or late else OK,
            f"{achieved:.1f} of {wanted:g} frames/s, {late} late",
            {
                "achieved_rate_hz": f"{achieved:.3f}",
                "rate_hz": f"{wanted:g}",
                "frames": str(self.frames),
                "late_frames": str(rate.late),
                "skipped_frames": str(rate.skipped),
                "frame_ms_p99": f"{frame_p99:.3f}",
                "frame_ms_max": f"{frame_longest:.3f}",
                "publish_ms_p99": f"{self.publish_ms.quantiles(0.99)[0]:.3f}",
            },
        )
        behind = not paused and bool(elapsed) and factor < 0.95
        stepping = Finding(
            "model",
            ERROR if lost else WARN if behind else OK,
            self.lost
            if lost
            else f"{model}: {steps / elapsed if elapsed else 0.0:.0f} steps/s, "
            f"{factor:.2f} x real time",
            {
                "model": model,
                "steps": str(self.steps),
                "steps_per_second": f"{steps / elapsed if elapsed else 0.0:.1f}",
                "step_ms_p50": f"{p50:.4f}",
                "step_ms_p99": f"{p99:.4f}",
                "step_ms_max": f"{longest:.4f}",
                "real_time_factor": f"{factor:.4f}",
                "residual_N": f"{self.residual:.6g}",
                "lost_states": str(self.lost_states),
                "components": str(self.components),
                "sutures": str(self.sutures),
                "suture_force_N": f"{self.suture_forces[0]:.4g}",
                "suture_force_max_N": f"{self.suture_forces[1]:.4g}",
            },
        )
        return [loop, stepping]


def tool_findings(trackers: Iterable[ToolTracker]) -> list[Finding]:
    """One finding per tool."""
    findings = []
    for tracker in list(trackers):
        state, reason = tracker.state, tracker.reason
        message = f"{state}: {reason}" if reason else state
        if tracker.refusal:
            message += f"; {tracker.refused} poses refused, the last one because {tracker.refusal}"
        findings.append(
            Finding(
                f"tool {tracker.spec.id}",
                WARN if state == FROZEN or tracker.refused else OK,
                message,
                {
                    "state": state,
                    "poses_received": str(tracker.received),
                    "poses_refused": str(tracker.refused),
                    "owner": tracker.spec.owner,
                },
            )
        )
    return findings


def wiring_finding(
    simulators: int, unknown_tools: Iterable[str], known_tools: Iterable[str], qos: Iterable[str]
) -> Finding:
    """What is wrong between nodes.

    Args:
        simulators: Publishers of tissue/state.
        unknown_tools: Tools that poses are published for and that are not there.
        known_tools: Tools that are there.
        qos: Topics with an incompatible quality of service, in words.
    """
    problems = list(qos)
    if simulators > 1:
        problems.append(f"{simulators} simulators publish the same tissue/state")
    unknown = sorted(unknown_tools)
    if unknown:
        known = ", ".join(sorted(known_tools)) or "none"
        problems.append(
            f"poses are published for unknown tools: {', '.join(unknown)}; known tools: {known}"
        )
    level = ERROR if simulators > 1 else WARN if problems else OK
    return Finding("wiring", level, "; ".join(problems) or "fine")
