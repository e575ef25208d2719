"""Where a recording comes from: software, machine, revision of the source."""

from __future__ import annotations

import platform
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path


def git_revision(directory: Path) -> str:
    """Revision of the work tree around a directory, `-dirty` if changed; empty without git."""
    command = ["git", "-C", str(directory), "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return answer.stdout.strip() if answer.returncode == 0 else ""


def provenance() -> dict[str, str]:
    """What every recording says about where it was made."""
    return {
        "recorded_by": "tissue_sim viz_bridge",
        "recorded_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "git_revision": git_revision(Path(__file__).resolve().parent),
        "machine": platform.machine(),
        "system": platform.platform(),
        "python": sys.version.split()[0],
    }
