"""Reads messages of any type from their bytes, knowing only the definition a bag carries.

Arrays of numbers come out as numpy views of the bytes, so a state of 35,000 nodes is read in
microseconds; a bag is read without ROS, and one recorded before a message changed is still read as
it was written.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from viz_bridge.message_text import PRIMITIVES, SEPARATOR

Message = SimpleNamespace
"""A decoded message: one attribute per field, nested messages likewise."""

_NUMBERS = {
    "bool": "?", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1",
    "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_STRUCT = {"?": "?", "u1": "B", "i1": "b", "i2": "h", "u2": "H", "i4": "i", "u4": "I",
           "i8": "q", "u8": "Q", "f4": "f", "f8": "d"}  # fmt: skip
_LINE = re.compile(
    r"^\s*(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?P<array>\[[^\]]*\])?\s+(?P<name>[A-Za-z]\w*)"
    r"\s*(?P<constant>=)?"
)


class CdrError(ValueError):
    """Bytes that are not a message of the type they are said to be."""


class _Cursor:
    """A place in one message; alignment counts from behind the 4-byte encapsulation header."""

    def __init__(self, data: bytes | memoryview) -> None:
        if len(data) < 4:
            raise CdrError(f"a message has at least 4 bytes; this one has {len(data)}")
        self.data = memoryview(data)
        if self.data[0] != 0 or self.data[1] > 1:
            raise CdrError(f"encapsulation {bytes(self.data[:2]).hex()} is not plain CDR")
        self.order = "<" if self.data[1] == 1 else ">"
        self.at = 4

    def align(self, size: int) -> None:
        self.at += -(self.at - 4) % size

    def number(self, code: str, size: int) -> Any:
        self.align(size)
        try:
            (value,) = struct.unpack_from(self.order + code, self.data, self.at)
        except struct.error as error:
            raise CdrError(f"the message ends in the middle of a field: {error}") from None
        self.at += size
        return value

    def numbers(self, dtype: str, count: int) -> Any:
        size = np.dtype(dtype).itemsize
        if count == 0:
            return np.empty(0, dtype=dtype)
        self.align(size)
        end = self.at + size * count
        if end > len(self.data):
            raise CdrError(f"an array of {count} items reaches beyond the end of the message")
        values = np.frombuffer(self.data, self.order + dtype, count, self.at)
        self.at = end
        return values

    def text(self) -> str:
        length = self.number("I", 4)
        end = self.at + length
        if end > len(self.data):
            raise CdrError(f"a text of {length} bytes reaches beyond the end of the message")
        raw = bytes(self.data[self.at : end])
        self.at = end
        return raw.rstrip(b"\0").decode("utf-8", errors="replace")


Reader = Callable[[_Cursor], Any]


class Decoder:
    """Turns bytes of one type into messages.

    Attributes:
        type_name: Such as `tissue_interfaces/msg/Journal`.
    """

    def __init__(self, type_name: str, definition: str) -> None:
        """Prepare for a type.

        Args:
            type_name: Name of the type.
            definition: Its `ros2msg` text, dependencies included.

        Raises:
            CdrError: A type it needs is not in the definition.
        """
        parts = type_name.split("/")
        self.type_name = type_name
        self._texts = {}
        sections = re.split(rf"^{SEPARATOR}\s*$", definition, flags=re.MULTILINE)
        main = f"{parts[0]}/{parts[-1]}"
        self._texts[main] = sections[0]
        for section in sections[1:]:
            head, _, body = section.strip().partition("\n")
            named = head.removeprefix("MSG:").strip().split("/")
            self._texts[f"{named[0]}/{named[-1]}"] = body
        self._readers: dict[str, Reader] = {}
        # ROS pads its messages to an estimated length, for which it aligns even empty lists.
        self._most_left = 8
        self._read = self._message(main)

    def __call__(self, data: bytes | memoryview) -> Message:
        """Read one message; numpy arrays in it are views of `data`.

        Raises:
            CdrError: The bytes are not a message of this type.
        """
        cursor = _Cursor(data)
        message: Message = self._read(cursor)
        if not 0 <= len(cursor.data) - cursor.at < self._most_left:
            raise CdrError(
                f"{self.type_name}: {len(cursor.data) - cursor.at} bytes are left over; "
                "the definition does not fit"
            )
        return message

    def _message(self, name: str) -> Reader:
        if name in self._readers:
            return self._readers[name]
        if name not in self._texts:
            raise CdrError(f"the definition of {self.type_name} lacks {name}")
        fields = []
        for line in self._texts[name].splitlines():
            match = _LINE.match(line.split("#", 1)[0])
            if match and not match["constant"]:
                item = self._item(match["type"], name.split("/")[0])
                if match["array"] and _NUMBERS.get(match["type"], "").endswith("8"):
                    self._most_left += 8
                fields.append((match["name"], _array(item, match["type"], match["array"])))
        # An empty message carries one byte, as C structs do.
        empty = not fields

        def read(cursor: _Cursor) -> Message:
            if empty:
                cursor.at += 1
            return Message(**{field: reader(cursor) for field, reader in fields})

        self._readers[name] = read
        return read

    def _item(self, type_name: str, package: str) -> Reader:
        if type_name == "string":
            return _Cursor.text
        if type_name in _NUMBERS:
            dtype = np.dtype(_NUMBERS[type_name])
            code, size = _STRUCT[_NUMBERS[type_name]], dtype.itemsize
            return lambda cursor: cursor.number(code, size)
        if type_name in PRIMITIVES:
            raise CdrError(f"fields of type {type_name} are not supported")
        parts = type_name.split("/")
        return self._message(
            f"{parts[0]}/{parts[-1]}" if len(parts) > 1 else f"{package}/{parts[0]}"
        )


def _array(item: Reader, type_name: str, brackets: str | None) -> Reader:
    if brackets is None:
        return item
    size = brackets.strip("[]")
    fixed = int(size) if size.isdigit() else None
    dtype = _NUMBERS.get(type_name)

    def read(cursor: _Cursor) -> Any:
        count = cursor.number("I", 4) if fixed is None else fixed
        if dtype is not None:
            return cursor.numbers(dtype, count)
        if count > len(cursor.data):
            raise CdrError(f"a list of {count} items cannot fit into {len(cursor.data)} bytes")
        return [item(cursor) for _ in range(count)]

    return read
