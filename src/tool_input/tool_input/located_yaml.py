"""YAML read with line numbers, so that a mistake is reported where it stands."""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray


class ProcedureError(ValueError):
    """A YAML file that makes no sense; the message names the file and the line."""


class Item:
    """A value of a YAML file that knows where it stands.

    Attributes:
        value: Plain value; `Item`s inside of lists and mappings.
        where: File and line, for people.
        name: What the value is, such as "timeline[3].at".
    """

    def __init__(self, value: object, where: str, name: str) -> None:
        self.value = value
        self.where = where
        self.name = name

    def error(self, message: str) -> ProcedureError:
        """An error that points at this value."""
        return ProcedureError(f"{self.where}: {self.name}: {message}")

    def mapping(self, allowed: Collection[str], required: Collection[str] = ()) -> dict[str, Item]:
        """The value as a mapping with known keys only.

        Raises:
            ProcedureError: It is none, has an unknown key or lacks a required one.
        """
        if not isinstance(self.value, dict):
            raise self.error(f"must be a mapping with the keys {', '.join(allowed)}")
        for key, item in self.value.items():
            if key not in allowed:
                raise ProcedureError(
                    f"{item.where}: {self.name}: unknown key {key!r}; "
                    f"allowed: {', '.join(sorted(allowed))}"
                )
        for key in required:
            if key not in self.value:
                raise self.error(f"the key {key!r} is missing")
        return self.value

    def entries(self) -> dict[str, Item]:
        """The value as a mapping with names of the author's choice."""
        if not isinstance(self.value, dict):
            raise self.error("must be a mapping from names to values")
        return self.value

    def list(self) -> list[Item]:
        """The value as a list."""
        if not isinstance(self.value, list):
            raise self.error("must be a list")
        return self.value

    def text(self) -> str:
        """The value as a text that is not empty."""
        if not isinstance(self.value, str) or not self.value.strip():
            raise self.error(f"must be a text, not {self.plain()!r}")
        return self.value

    def one_of(self, allowed: Collection[str]) -> str:
        """The value as one of a few words."""
        if self.value not in allowed:
            raise self.error(f"{self.plain()!r} is not allowed; allowed: {', '.join(allowed)}")
        return str(self.value)

    def flag(self) -> bool:
        """The value as true or false."""
        if not isinstance(self.value, bool):
            raise self.error(f"must be true or false, not {self.plain()!r}")
        return self.value

    def number(
        self, minimum: float = -math.inf, above: float = -math.inf, maximum: float = math.inf
    ) -> float:
        """The value as a finite number from `minimum` to `maximum`, greater than `above`."""
        value = self.value
        if isinstance(value, str):
            value = _number_of(value)  # YAML 1.1 takes 1e-3, which lacks a point, for a text
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(f"must be a number, not {self.plain()!r}")
        if not math.isfinite(value):
            raise self.error(f"must be a finite number, not {value}")
        if value < minimum:
            raise self.error(f"must be at least {minimum:g}, not {value:g}")
        if value <= above:
            raise self.error(f"must be greater than {above:g}, not {value:g}")
        if value > maximum:
            raise self.error(f"must be at most {maximum:g}, not {value:g}")
        return float(value)

    def whole(self, minimum: int, maximum: int) -> int:
        """The value as a whole number from `minimum` to `maximum`."""
        value = self.number()
        if value != int(value) or not minimum <= value <= maximum:
            raise self.error(f"must be a whole number from {minimum} to {maximum}, not {value:g}")
        return int(value)

    def vector(self, length: int) -> NDArray[np.float64]:
        """The value as a list of finite numbers, shape (length,)."""
        items = self.list()
        if len(items) != length:
            raise self.error(f"must have {length} numbers, not {len(items)}")
        return np.array([item.number() for item in items])

    def plain(self) -> object:
        """The value without line numbers."""
        if isinstance(self.value, dict):
            return {key: item.plain() for key, item in self.value.items()}
        if isinstance(self.value, list):
            return [item.plain() for item in self.value]
        return self.value


def _number_of(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def read_located(text: str, source: str, name: str = "procedure") -> Item:
    """A YAML text as nested `Item`s.

    Args:
        text: The document.
        source: Name of the file, for messages.
        name: What the document is, for messages.

    Raises:
        ProcedureError: The text is no YAML, is empty or names a key twice.
    """
    try:
        loader = yaml.SafeLoader(text)
        try:
            root = loader.get_single_node()
            if root is None:
                raise ProcedureError(f"{source}: the file is empty")
            return _item(loader, root, source, name)
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ProcedureError(f"{source}:{line}: no valid YAML: {error.problem}") from None
    except yaml.YAMLError as error:
        raise ProcedureError(f"{source}: no valid YAML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise ProcedureError(f"{source}: nested too deeply") from None


def read_located_file(path: Path, name: str = "procedure") -> Item:
    """A YAML file as nested `Item`s; see `read_located`.

    Raises:
        ProcedureError: The file cannot be read or is no YAML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ProcedureError(f"{path}: cannot be read: {error}") from None
    return read_located(text, str(path), name)


def _item(loader: yaml.SafeLoader, node: yaml.Node, source: str, name: str) -> Item:
    where = f"{source}:{node.start_mark.line + 1}"
    if isinstance(node, yaml.MappingNode):
        entries: dict[str, Item] = {}
        for key_node, value_node in node.value:
            key = str(loader.construct_object(key_node, deep=True))
            place = f"{source}:{key_node.start_mark.line + 1}"
            if key in entries:
                raise ProcedureError(f"{place}: {name}: the key {key!r} appears twice")
            child = _item(loader, value_node, source, f"{name}.{key}" if name else key)
            entries[key] = Item(child.value, place, child.name)
        return Item(entries, where, name)
    if isinstance(node, yaml.SequenceNode):
        values = [
            _item(loader, child, source, f"{name}[{index}]")
            for index, child in enumerate(node.value)
        ]
        return Item(values, where, name)
    try:
        return Item(loader.construct_object(node, deep=True), where, name)
    except (yaml.YAMLError, ValueError) as error:
        raise ProcedureError(f"{where}: {name}: {' '.join(str(error).split())}") from None
