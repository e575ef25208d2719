"""Somebody at the operating table: one window, its name and its tools."""

from __future__ import annotations

import inspect
import time
import traceback
from collections import deque
from collections.abc import Callable, Coroutine, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from tissue_interfaces.msg import Tool
from tissue_interfaces.srv import Release, RemoveTool, SetTool

from tool_input.motion import Pose
from tool_input.tool_topics import ToolTopics, pose_message

if TYPE_CHECKING:
    from tool_input.table.desk import Desk

ARRIVAL_PATIENCE = 0.25
"""Longest wait of a press for the tool to be there [s]; limits of its speed may keep it away."""

ARRIVED = 1e-4
"""Distance from where it is wanted at which a tool is there [m]."""

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
"""The orientation of a tool whose axes are the organ's."""


class PersonTool:
    """One tool of a person: made in the simulation, moved by its topics.

    While it has a pose that pose is published again and again, as a hand that rests would.

    A press waits until somebody listens to both its topics and the simulation says that the tool is
    where it was pressed: of two topics the later message may come first, and then the tool would
    take hold where it was before. What comes after the press waits with it. A press that is over
    before anybody listens is not sent. The publishers are there before the tool, so the simulation
    knows them when it begins to listen.

    Attributes:
        name: Its name among the person's tools, such as "grab".
        id: Its name in the simulation, `<person>_<name>`.
        message: What `tissue/set_tool` was asked for last.
        pose: Where it is wanted; None: it has not been moved yet.
        pressed: Whether it is in use.
    """

    def __init__(self, person: Person, name: str, tool: str = "") -> None:
        """Begin with a tool that is not there yet; see `PersonTools.make`.

        Args:
            person: Whose it is.
            name: Its name among their tools.
            tool: Its name in the simulation; empty: one that nobody else gives.
        """
        self._person = person
        self.name = name
        self.id = tool or f"{person.tool_prefix}_{name}"
        self.message = Tool(id=self.id, owner=person.name)
        self.pose: Pose | None = None
        self.pressed = False
        self._topics = ToolTopics(person.desk.node, self.id, person.desk.frame_id)
        self._listeners = 0
        self._rests = False
        self._told: bool | None = None
        self._due: deque[tuple[bool, Pose | None]] = deque()
        self._waits_until = np.inf

    def change(self, kind: str, shape: str, size: Sequence[float], **more: Any) -> None:
        """Ask for another kind, shape or size [m] of it; `more` are fields of `Tool`."""
        self.message.kind, self.message.shape = kind, shape
        self.message.size = [float(value) for value in size]
        for field, value in more.items():
            setattr(self.message, field, value)
        if self.pose is not None:
            self.message.pose = pose_message(self.pose)
        self._person.request("set_tool", SetTool.Request(tool=self.message))

    def move(self, position: ArrayLike, quaternion: ArrayLike | None = None) -> None:
        """Want it somewhere: position [m], and quaternion x y z w (as it is, if none is given)."""
        turned = UPRIGHT if self.pose is None else self.pose.quaternion
        if quaternion is not None:
            turned = np.asarray(quaternion, dtype=np.float64)
        self.pose = Pose(np.asarray(position, dtype=np.float64), turned)
        self._tell_pose()

    def use(self, pressed: bool) -> None:
        """Press or release it where it is."""
        self.pressed = pressed
        if self._listeners or pressed:
            self._due.append((pressed, self.pose))
        else:
            self._due.clear()
        self.repeat()

    def repeat(self) -> None:
        """Publish where it is once more, and of its use what is not known to who listens."""
        # Counted before the pose is sent: whoever is told of a press has been sent the pose.
        listeners = self._topics.listeners
        self._tell_pose()
        self._tell_use(listeners)

    def _tell_pose(self) -> None:
        pose = self._due[0][1] if self._due else self.pose
        if pose is not None:
            self._topics.pose(pose)

    def _tell_use(self, listeners: int) -> None:
        before, self._listeners = self._listeners, listeners
        if listeners > before:
            # The first level that is heard makes no edge: a press must be the second.
            self._say(bool(self._told) if before else self._rests)
        if not listeners:
            return
        if not self._due and self._told != self.pressed:
            self._due.append((self.pressed, self.pose))
        while self._due:
            pressed, pose = self._due[0]
            if pressed and not self._is_at(pose):
                break
            self._say(pressed)
            self._due.popleft()
            self._waits_until = np.inf

    def _is_at(self, pose: Pose | None) -> bool:
        """Whether the simulation has the tool there, or that was waited for long enough."""
        if pose is None:
            return True
        now = time.monotonic()
        self._waits_until = min(self._waits_until, now + ARRIVAL_PATIENCE)
        if now > self._waits_until:
            return True
        desk = self._person.desk
        if self.id not in desk.tools:
            return False
        return bool(np.linalg.norm(desk.pose(self.id)[:3] - pose.position) < ARRIVED)

    def _say(self, pressed: bool) -> None:
        self._told = pressed
        self._topics.use(pressed)

    def remove(self) -> None:
        """Let go and take it out of the simulation."""
        if self.pressed:
            self.use(False)
        self._person.request("remove_tool", RemoveTool.Request(tool=self.id))
        self._topics.close()

    def make_again(self) -> bool:
        """Ask for it once more, released, after another organ was loaded; False: it is gone."""
        if self.pressed:
            self.use(False)
        self._person.request("set_tool", SetTool.Request(tool=self.message))
        return True


class TakenTool(PersonTool):
    """A tool that was there before: of the scene, or of a recording that was taken over.

    It stays as it is, in use or not, until its person does something with it, and is not removed
    when they leave.
    """

    def __init__(self, person: Person, tool: Tool) -> None:
        """Take a tool that is there."""
        super().__init__(person, tool.id, tool.id)
        self.message = tool
        self.pressed = self._rests = tool.pressed
        self._used = False

    def move(self, position: ArrayLike, quaternion: ArrayLike | None = None) -> None:
        """Want it somewhere; the orientation is at first the one it has."""
        if self.pose is None and quaternion is None:
            quaternion = self._person.desk.pose(self.id)[3:]
        super().move(position, quaternion)

    def use(self, pressed: bool) -> None:
        """Press or release it where it is."""
        self._used = True
        super().use(pressed)

    def _tell_use(self, listeners: int) -> None:
        if self._used:
            super()._tell_use(listeners)

    def remove(self) -> None:
        """Let go and leave it where it is."""
        if self.pressed:
            self.use(False)
        self._topics.close()

    def make_again(self) -> bool:
        """It belonged to what was there before, and is let be."""
        self._topics.close()
        return False


class PersonTools:
    """The tools of one person by their short names, such as "grab"."""

    def __init__(self, person: Person) -> None:
        """Begin with none."""
        self._person = person
        self._tools: dict[str, PersonTool] = {}

    def make(
        self, name: str, kind: str, shape: str, size: Sequence[float], **more: Any
    ) -> PersonTool:
        """Make a tool, or change the one of that name.

        Args:
            name: Short name; the tool is called `<person>_<name>`.
            kind: `Tool.GRAB`, `CUT`, `BURN`, `PATCH` or `PROBE`.
            shape: One that the kind can have; see `Tool`.
            size: Of the shape [m].
            more: Further fields of `Tool`, such as `cutting`.

        Raises:
            ValueError: The person only watches.
        """
        self._person.refuse_observers("move tools")
        tool = self._tools.get(name)
        if tool is None:
            tool = self._tools[name] = PersonTool(self._person, name)
        tool.change(kind, shape, size, **more)
        return tool

    def take(self, tool: str) -> TakenTool:
        """Take a tool that is there and that nobody moves.

        Args:
            tool: Its name in the simulation.

        Raises:
            ValueError: There is none, somebody or a recording moves it, or the person only
                watches.
        """
        self._person.refuse_observers("move tools")
        desk = self._person.desk
        known = self._tools.get(tool)
        if isinstance(known, TakenTool):
            return known
        if tool not in desk.tools:
            raise ValueError(f"there is no tool {tool}; there are: {', '.join(desk.tools)}")
        if desk.node.count_publishers(f"tools/{tool}/servo_cp"):
            raise ValueError(f"{tool} is moved by somebody: a tool has one hand at a time")
        played = desk.playback
        if played is not None and tool not in played.taken_over:
            raise ValueError(f"{tool} is moved by the recording: take it over first")
        taken = self._tools[tool] = TakenTool(self._person, desk.tools[tool])
        return taken

    @property
    def names(self) -> tuple[str, ...]:
        """Short names of those there are."""
        return tuple(self._tools)

    def of_kind(self, kind: str) -> list[PersonTool]:
        """Those of a kind, in the order in which they were made."""
        return [tool for tool in self._tools.values() if tool.message.kind == kind]

    def release(self) -> None:
        """Let go of everything."""
        for tool in self._tools.values():
            if tool.pressed:
                tool.use(False)
            self._person.request("release", Release.Request(tool=tool.id))

    def remove(self, name: str) -> None:
        """Take a tool out of the simulation, if there is one of this name."""
        tool = self._tools.pop(name, None)
        if tool is not None:
            tool.remove()

    def clear(self) -> None:
        """Take all of them out."""
        for name in list(self._tools):
            self.remove(name)

    def make_again(self) -> None:
        """Release all of them and ask for them once more, after another organ was loaded."""
        for name, tool in list(self._tools.items()):
            if not tool.make_again():
                del self._tools[name]

    def repeat(self) -> None:
        """Publish where they are once more."""
        for tool in self._tools.values():
            tool.repeat()


class Person:
    """Somebody who works or watches in one window.

    Attributes:
        name: Such as "anna-1"; the owner of the tools and the author of the edits.
        desk: What connects everybody to the simulation.
        observer: Whether the person only watches.
        tools: Their tools.
    """

    def __init__(
        self, name: str, desk: Desk, tell: Callable[[str], None], observer: bool = False
    ) -> None:
        """Begin without tools.

        Args:
            name: Letters, digits, `_` and `-`.
            desk: What connects everybody to the simulation.
            tell: Shows a text in their window.
            observer: Whether the person only watches.
        """
        self.name = name
        self.desk = desk
        self.observer = observer
        self.tell = tell
        self.tools = PersonTools(self)
        self._mistakes: set[str] = set()

    @property
    def tool_prefix(self) -> str:
        """What the names of their tools begin with; topics have no hyphens."""
        return self.name.replace("-", "_")

    def request(
        self, service: str, request: Any, answered: Callable[[Any], None] | None = None
    ) -> None:
        """Ask the simulation for something: `Desk.request` in the person's name."""
        self.desk.request(self, service, request, answered)

    def refuse_observers(self, doing: str) -> None:
        """Stop those who only watch.

        Raises:
            ValueError: The person only watches.
        """
        if self.observer:
            raise ValueError(
                f"observers cannot {doing}: open the page's other address to take part"
            )

    def in_turn(self, act: Callable[..., object]) -> Callable[..., Coroutine[Any, Any, None]]:
        """A callback for viser that acts in the node's thread, in the order of the events.

        Args:
            act: Called with viser's event, or without it if it needs no argument. What it raises
                is told to the person.
        """
        given = inspect.signature(act).parameters.values()
        takes_event = any(parameter.default is parameter.empty for parameter in given)

        async def callback(event: Any) -> None:
            self.desk.soon(lambda: self.attempt(act, *([event] if takes_event else [])))

        return callback

    def attempt(self, act: Callable[..., object], *arguments: Any) -> None:
        """Act, and tell the person why it cannot be done if it cannot.

        A mistake of the page itself is told and logged once: it ends nobody else's work.
        """
        try:
            act(*arguments)
        except ValueError as error:
            self.tell(str(error))
        except Exception as error:
            where = traceback.format_exc()
            if where not in self._mistakes:
                self._mistakes.add(where)
                self.desk.node.get_logger().error(f"{self.name}: {where}")
                self.tell(f"The page failed: {type(error).__name__}: {error}. Its log says where.")

    def leave(self) -> None:
        """The window is gone: let go of everything."""
        self.tools.clear()
