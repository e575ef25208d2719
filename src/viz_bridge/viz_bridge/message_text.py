"""Definitions of message types, as bags carry them."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

SEPARATOR = "=" * 80
PRIMITIVES = frozenset(
    (
        *("bool", "byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32"),
        *("int64", "uint64", "float32", "float64", "string", "wstring"),
    )
)
_FIELD = re.compile(r"^\s*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*")


class UnknownTypeError(ValueError):
    """A message type whose definition is not installed."""


def split_type(type_name: str) -> tuple[str, str]:
    """Package and name of a type such as `std_msgs/msg/Header` or `std_msgs/Header`.

    Raises:
        UnknownTypeError: It is no such name.
    """
    parts = type_name.split("/")
    if len(parts) not in (2, 3) or not all(parts):
        raise UnknownTypeError(f"{type_name!r} is not a message type: expected package/msg/Name")
    return parts[0], parts[-1]


@cache
def definition_file(package: str, name: str, suffix: str = "msg") -> Path:
    """Where an installed message type is defined.

    Raises:
        UnknownTypeError: No prefix of AMENT_PREFIX_PATH has it.
    """
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    for prefix in prefixes:
        path = Path(prefix) / "share" / package / "msg" / f"{name}.{suffix}"
        if path.is_file():
            return path
    raise UnknownTypeError(
        f"no definition of {package}/msg/{name}: looked in share/{package}/msg of "
        f"{len(prefixes)} prefixes in AMENT_PREFIX_PATH; source the workspace that has it"
    )


@cache
def message_text(type_name: str) -> str:
    """The definition of a type in `ros2msg` encoding: its text, then that of each type it needs.

    Raises:
        UnknownTypeError: The type or one it needs is not installed.
    """
    main = split_type(type_name)
    parts = [definition_file(*main).read_text(encoding="utf-8")]
    seen, waiting = {main}, [main]
    while waiting:
        for needed in _needs(*waiting.pop(0)):
            if needed not in seen:
                seen.add(needed)
                waiting.append(needed)
                text = definition_file(*needed).read_text(encoding="utf-8")
                parts.append(f"MSG: {needed[0]}/{needed[1]}\n{text}")
    return f"\n{SEPARATOR}\n".join(part.rstrip("\n") for part in parts) + "\n"


@cache
def type_hash(type_name: str) -> str:
    """The RIHS01 hash of a type; empty where the installation does not say."""
    package, name = split_type(type_name)
    try:
        described = json.loads(definition_file(package, name, "json").read_text(encoding="utf-8"))
    except (UnknownTypeError, json.JSONDecodeError):
        return ""
    wanted = f"{package}/msg/{name}"
    hashes = {h["type_name"]: h["hash_string"] for h in described.get("type_hashes", [])}
    return str(hashes.get(wanted, ""))


def _needs(package: str, name: str) -> Iterator[tuple[str, str]]:
    for line in definition_file(package, name).read_text(encoding="utf-8").splitlines():
        match = _FIELD.match(line.split("#", 1)[0])
        if match and match[1] not in PRIMITIVES:
            yield split_type(match[1]) if "/" in match[1] else (package, match[1])
