"""What becomes of a request to cut."""

from __future__ import annotations

from dataclasses import dataclass

from cut_service.errors import CutCode
from cut_service.work import Plan


@dataclass(frozen=True)
class Outcome:
    """The answer to one request."""

    code: CutCode
    message: str
    version: int = 0
    plan: Plan | None = None
    apply_ms: float = 0.0
