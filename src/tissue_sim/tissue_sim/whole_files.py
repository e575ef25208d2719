"""Files that are there whole or not at all: nobody who waits for one finds half of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def write_json(path: Path, content: Any) -> None:
    """Write JSON, in place of what the file held before.

    Args:
        path: The file; its folder is there.
        content: Plain JSON values.
    """
    write_text(path, json.dumps(content, indent=1) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text, in place of what the file held before.

    Args:
        path: The file; its folder is there.
        text: What it shall hold.
    """
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
