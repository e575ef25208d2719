"""Who did which session, and how people rated it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from tool_input.located_yaml import Item, ProcedureError, read_located_file

EXPERT, TRAINEE = "expert", "trainee"
ROLES = (EXPERT, TRAINEE)


@dataclass(frozen=True)
class Entry:
    """One session of a study.

    Attributes:
        bag: Its bag.
        person: Who did it; empty: nobody said.
        session: Which session of that person, such as "1"; empty: nobody said.
        role: expert or trainee; empty: nobody said.
        ratings: Scores by rater and item, of those who watched it.
    """

    bag: Path
    person: str = ""
    session: str = ""
    role: str = ""
    ratings: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """What to call it: person and session, or the bag."""
        if not self.person:
            bag = self.bag.resolve()
            # `tissue run` calls all its bags "session"; their folders tell them apart.
            return bag.parent.name if bag.name == "session" else bag.stem
        return f"{self.person} {self.session}".strip()


def parse_entry(text: str) -> Entry:
    """A session as the command line names it: BAG, BAG@PERSON or BAG@PERSON:SESSION.

    Raises:
        ValueError: The person's name is empty.
    """
    bag, at, who = text.rpartition("@")
    if not at or Path(text).exists():
        return Entry(Path(text))
    person, _, session = who.partition(":")
    if not (bag and person.strip()):
        raise ValueError(f"{text!r} names nobody; allowed: BAG, BAG@PERSON or BAG@PERSON:SESSION")
    return Entry(Path(bag), person.strip(), session.strip())


def read_study(path: Path) -> list[Entry]:
    """The sessions of a study file: `sessions`, a list of `bag` and what is known of it.

    Bags are relative to the file.

    Raises:
        ProcedureError: The file cannot be read; the message names the line.
    """
    root = read_located_file(path, "study")
    items = root.mapping(("sessions",), ("sessions",))["sessions"].list()
    if not items:
        raise ProcedureError(f"{path}: the study has no session")
    return [_entry(item, path.parent) for item in items]


def with_experts(entries: Sequence[Entry], experts: Sequence[str]) -> list[Entry]:
    """Entries with the experts marked, by person or name of the session; the rest are trainees.

    Raises:
        ValueError: No session is by such an expert.
    """
    for expert in experts:
        if not any(expert in (entry.person, entry.name, str(entry.bag)) for entry in entries):
            there = ", ".join(dict.fromkeys(e.person or e.name for e in entries))
            raise ValueError(f"no session is by expert {expert!r}; there are: {there}")
    if not experts:
        return list(entries)
    return [
        replace(
            entry,
            role=EXPERT
            if {entry.person, entry.name, str(entry.bag)} & set(experts)
            else entry.role or TRAINEE,
        )
        for entry in entries
    ]


def named_apart(entries: Sequence[Entry]) -> list[str]:
    """A name for each session that no other has."""
    names = [entry.name for entry in entries]
    return [
        name if names.count(name) == 1 else f"{name} ({number})"
        for number, name in enumerate(names, start=1)
    ]


def _entry(item: Item, folder: Path) -> Entry:
    keys = item.mapping(("bag", "person", "session", "role", "ratings"), ("bag",))
    return Entry(
        folder / keys["bag"].text(),
        keys["person"].text() if "person" in keys else "",
        str(keys["session"].plain()) if "session" in keys else "",
        keys["role"].one_of(ROLES) if "role" in keys else "",
        {
            rater: {name: score.number() for name, score in scores.entries().items()}
            for rater, scores in (keys["ratings"].entries() if "ratings" in keys else {}).items()
        },
    )
