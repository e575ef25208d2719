"""What a search has found so far, in a file from which it can go on."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from tissue_sim.compare.fit.problem import Evaluation
from tissue_sim.whole_files import write_json

FORMAT = 1
"""Version of the files that `Checkpoint.save` writes."""


class CheckpointError(ValueError):
    """A file is no checkpoint, or one of another search; the message says what differs."""


@dataclass(frozen=True)
class Generation:
    """What one generation of a search came to.

    Attributes:
        number: Counted from 1.
        best: Smallest error so far.
        median: Median of the errors of its candidates.
        played: Candidates whose values had not been evaluated before.
        unstable: Candidates that were lost or refused.
    """

    number: int
    best: float
    median: float
    played: int
    unstable: int


@dataclass
class Checkpoint:
    """A search between two generations.

    Attributes:
        identity: What tells the search from any other, as plain JSON values by name.
        evaluations: All evaluations, in the order of the candidates.
        history: The generations.
        strategy: State of the strategy; None: it has not begun.
    """

    identity: dict[str, Any]
    evaluations: list[Evaluation] = field(default_factory=list)
    history: list[Generation] = field(default_factory=list)
    strategy: dict[str, Any] | None = None

    def save(self, path: Path) -> None:
        """Write it as JSON, whole or not at all."""
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, {"kind": "fit checkpoint", "format": FORMAT, **asdict(self)})

    @classmethod
    def resume(cls, path: Path | None, identity: dict[str, Any]) -> Checkpoint:
        """The checkpoint of a search; a new one where there is no file.

        Raises:
            CheckpointError: The file is no checkpoint, or one of another search.
            OSError: It cannot be read.
        """
        if path is None or not path.exists():
            return cls(identity)
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if content["kind"] != "fit checkpoint" or content["format"] != FORMAT:
                raise ValueError(f"it is a {content['kind']} of format {content['format']}")
            before = content["identity"]
            evaluations = [Evaluation.from_json(entry) for entry in content["evaluations"]]
            history = [Generation(**entry) for entry in content["history"]]
            strategy = content["strategy"]
        except (KeyError, TypeError, ValueError) as error:
            raise CheckpointError(f"{path} is no checkpoint of a fit: {error!r}") from error
        _check_same(path, before, json.loads(json.dumps(identity)))
        return cls(identity, evaluations, history, strategy)


def _check_same(path: Path, before: dict[str, Any], now: dict[str, Any]) -> None:
    names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    if names:
        differ = "; ".join(
            f"{name}: {json.dumps(before.get(name))} there, {json.dumps(now.get(name))} here"
            for name in names
        )
        raise CheckpointError(
            f"{path} is the checkpoint of another fit ({differ}); allowed: the same fit, or "
            "another file"
        )
