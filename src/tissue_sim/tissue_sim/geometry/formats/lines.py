"""Lines of a text mesh file with their numbers, for errors that name the line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from tissue_sim.geometry.errors import MeshFileError


class Lines:
    """Meaningful lines of a text file: comments (#) and empty lines left out.

    Attributes:
        path: The file.
        number: Number of the line given last, from 1.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.number = 0
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError as error:
            raise MeshFileError(f"{path}: not a text file ({error.reason})") from error
        self._lines = iter(text.splitlines())

    def __iter__(self) -> Iterator[list[str]]:
        while True:
            words = self.next_or_none()
            if words is None:
                return
            yield words

    def next_or_none(self) -> list[str] | None:
        """Words of the next meaningful line, None at the end of the file."""
        for line in self._lines:
            self.number += 1
            words = line.partition("#")[0].split()
            if words:
                return words
        return None

    def next(self, wanted: str) -> list[str]:
        """Words of the next meaningful line.

        Raises:
            MeshFileError: The file ends here.
        """
        words = self.next_or_none()
        if words is None:
            raise MeshFileError(
                f"{self.path}: the file ends where {wanted} was expected (cut off?)"
            )
        return words

    def error(self, reason: str) -> MeshFileError:
        """An error that names this line."""
        return MeshFileError(f"{self.path}, line {self.number}: {reason}")

    def integers(self, words: list[str], at_least: int) -> list[int]:
        """The words as whole numbers.

        Raises:
            MeshFileError: Too few words, or one is not a whole number.
        """
        if len(words) < at_least:
            raise self.error(f"{len(words)} numbers, at least {at_least} are wanted")
        try:
            return [int(word) for word in words]
        except ValueError:
            raise self.error(f"whole numbers are wanted, not {' '.join(words)[:60]!r}") from None

    def reals(self, words: list[str], count: int) -> list[float]:
        """The first `count` words as numbers.

        Raises:
            MeshFileError: Too few words, or one is not a number.
        """
        if len(words) < count:
            raise self.error(f"{len(words)} numbers, {count} are wanted")
        try:
            return [float(word) for word in words[:count]]
        except ValueError:
            raise self.error(f"numbers are wanted, not {' '.join(words)[:60]!r}") from None
