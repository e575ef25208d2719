"""From what a source sends to the pose as used: the only place where wall-clock time counts."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.frame import Edge, ToolSample
from tissue_sim.interaction import rigid
from tissue_sim.interaction.tools import ToolSpec

ACTIVE, FROZEN, FREE = "active", "frozen", "free"


@dataclass(frozen=True)
class ToolLimits:
    """What a source may do.

    Attributes:
        max_tool_speed: Fastest a tool that holds tissue is moved [m/s].
        max_jump: Farthest two poses in a row may lie apart while the tool holds tissue [m].
        pose_timeout: A pose older than this is stale and freezes the tool [s].
        release_timeout: A pose older than this makes the tool let go [s].
    """

    max_tool_speed: float = 0.5
    max_jump: float = 0.05
    pose_timeout: float = 0.2
    release_timeout: float = 2.0


@dataclass(frozen=True)
class _Received:
    pose: NDArray[np.float64]
    stamp: int
    at: float


class ToolTracker:
    """Follows one tool's source; called by the loop thread only.

    The newest pose counts. Poses are mapped by scale, offset and clutch; a tool that holds tissue
    moves at most `max_tool_speed`. A tool is frozen (stays where it was, keeps what it holds) while
    its pose is stale, while it has several sources, and from a jump until `use` is released. A pose
    that is stale for `release_timeout` makes it let go; after that, and with several sources, a
    press of `use` does nothing until it is released and pressed again.

    Attributes:
        spec: What the tool is.
        pose: Its pose as used last, in the organ frame, shape (7,).
        received: Number of poses received.
        refused: Number of poses refused, and why the last one was.
    """

    def __init__(self, spec: ToolSpec, limits: ToolLimits) -> None:
        self.spec, self.limits = spec, limits
        self.pose = np.array(spec.pose)
        self.received = 0
        self.refused = 0
        self.refusal = ""
        self._newest: _Received | None = None
        self._edges: deque[tuple[bool, _Received | None]] = deque()
        self._source_level: bool | None = None
        self._level = False
        self._used_stamp = 0
        self._sources: tuple[str, ...] = ()
        self._jump = ""
        self._farthest_step = 0.0
        self._let_go = False
        self._stale = False
        self._clutched = False
        self._at_clutch: NDArray[np.float64] | None = None
        # Where it is until a source says otherwise.
        self._waits_at = self.pose
        # The source's place and orientation that correspond to `_base`.
        self._reference = rigid.IDENTITY
        self._base = np.array([*spec.offset, *rigid.IDENTITY[3:]])

    @property
    def stamp(self) -> int:
        """Stamp of the pose applied last [ns]; 0 before there is one."""
        return self._used_stamp

    @property
    def pressed(self) -> bool:
        """Whether it was in use in the last frame."""
        return self._level

    @property
    def reason(self) -> str:
        """Why the tool is frozen; empty: it is not."""
        if len(self._sources) > 1:
            return f"has {len(self._sources)} sources: {', '.join(self._sources)}; allowed: one"
        if self._jump:
            return self._jump
        if self._stale:
            timeout = self.limits.pose_timeout
            return f"no pose for more than {timeout:g} s" + (", let go" if self._let_go else "")
        return ""

    @property
    def state(self) -> str:
        """active, frozen or free."""
        if self.reason:
            return FROZEN
        return ACTIVE if self._newest else FREE

    def receive_pose(self, pose: NDArray[np.float64], stamp: int, now: float) -> None:
        """Take a pose from the source.

        Args:
            pose: In the organ frame, already checked, shape (7,).
            stamp: Its stamp [ns].
            now: Local steady time of its receipt [s].
        """
        self.received += 1
        before, self._newest = self._newest, _Received(pose, stamp, now)
        if before is not None and not self._clutched:
            step = self.spec.scale * float(np.linalg.norm(pose[:3] - before.pose[:3]))
            self._farthest_step = max(self._farthest_step, step)

    def refuse_pose(self, reason: str) -> None:
        """Count a pose that could not be used."""
        self.refused += 1
        self.refusal = reason

    def receive_use(self, pressed: bool) -> None:
        """Take a level of `use`; the first one makes no edge."""
        if self._source_level is None:
            self._level = pressed
        elif pressed != self._source_level:
            self._edges.append((pressed, self._newest))
        self._source_level = pressed

    def receive_clutch(self, engaged: bool) -> None:
        """Engage the clutch (the tool stays while its source moves), or let it in again."""
        if engaged and not self._clutched:
            self._at_clutch = self.pose.copy()
        if not engaged and self._clutched and self._newest is not None:
            self._reference = self._newest.pose.copy()
            self._base = self.pose.copy()
        self._clutched = engaged

    def set_sources(self, names: list[str]) -> None:
        """Say which nodes publish the tool's pose."""
        self._sources = tuple(sorted(names))

    def adopt(self, sample: ToolSample) -> None:
        """Be as somebody else has used the tool, so that the first source goes on from there."""
        self.pose = self._waits_at = sample.pose.copy()
        self._used_stamp = sample.stamp
        self._level = self._source_level = sample.use

    def change(self, spec: ToolSpec) -> None:
        """Change what the tool is, keeping its source; without one it goes to the new pose."""
        self.spec = spec
        self._waits_at = np.array(spec.pose)
        self._base = np.array([*spec.offset, *rigid.IDENTITY[3:]])
        self._reference = rigid.IDENTITY

    def sample(self, now: float, period: float, holding: bool) -> tuple[ToolSample, bool]:
        """The tool as used in the frame that begins now.

        Args:
            now: Local steady time [s].
            period: Time since the last frame, for the limit of speed [s].
            holding: Whether it holds tissue, or cuts it as it moves.

        Returns:
            The sample, and whether the tool must let go of everything because its pose is stale.
        """
        release_now = self._watch(now)
        self._watch_jumps(holding)
        pressed, source = self._next_edge()
        edge: Edge = 0
        if pressed is False and self._level:
            edge = -1
        elif pressed and not self._level and not self._let_go and len(self._sources) < 2:
            edge = 1
        if release_now and self._level:
            edge = -1
        if edge:
            self._level = edge == 1
        if not self._clutched and not self.reason:
            self._follow(source, self.limits.max_tool_speed * period if holding else np.inf)
        if not self._level and (edge == -1 or not holding):
            self._jump = ""
        sample = ToolSample(self.spec.id, self.pose.copy(), self._used_stamp, self._level, edge)
        return sample, release_now

    def _watch(self, now: float) -> bool:
        """Notice a stale pose; whether it has just become time to let go."""
        if self._newest is None:
            return False
        age = now - self._newest.at
        self._stale = age > self.limits.pose_timeout
        expired = age > self.limits.release_timeout
        just_expired = expired and not self._let_go
        self._let_go = expired
        return just_expired

    def _watch_jumps(self, holding: bool) -> None:
        """Notice a jump between poses that came since the last frame."""
        step, self._farthest_step = self._farthest_step, 0.0
        if holding and not self._jump and step > self.limits.max_jump:
            self._jump = (
                f"jumped {step:.4g} m while it holds or cuts; allowed: {self.limits.max_jump:g} m; "
                "release use to go on"
            )

    def _next_edge(self) -> tuple[bool | None, _Received | None]:
        """At most one edge takes effect in a frame, with the newest pose received before it."""
        if not self._edges:
            return None, self._newest
        return self._edges.popleft()

    def _follow(self, source: _Received | None, farthest: float) -> None:
        """Go where the source is, or to the tool's own pose without one, but not too far."""
        wanted = self._waits_at.copy() if source is None else self._mapped(source.pose)
        way = wanted[:3] - self.pose[:3]
        distance = float(np.linalg.norm(way))
        if distance > farthest:
            wanted[:3] = self.pose[:3] + way * (farthest / distance)
        self.pose = wanted
        if source is not None:
            self._used_stamp = source.stamp

    def _mapped(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """A source's pose through scale, offset and clutch."""
        position = self._base[:3] + self.spec.scale * (pose[:3] - self._reference[:3])
        turn = rigid.multiply(self._base[3:], rigid.conjugate(self._reference[3:]))
        return np.concatenate([position, rigid.multiply(turn, pose[3:])])
