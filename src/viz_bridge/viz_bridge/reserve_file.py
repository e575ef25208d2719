"""A file that can still be ended when the disk is full."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path

FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
FIRST_RESERVE = 1 << 20
RESERVE_SHARE = 0.02


class DiskFullError(OSError):
    """The disk is full; the file ends behind the last whole write."""


class ReserveFile:
    """A file written at the end only, with disk space set aside for its ending.

    A second file holds the reserve. When the disk is full it is deleted, the write that failed is
    finished in its place and `full` is set: the owner then ends the file. Each `write` is whole or
    is taken back.

    Attributes:
        full: Why no more should be written; empty while there is room.
    """

    def __init__(self, path: Path, reserve: bool = True) -> None:
        self.path = path
        self.full = ""
        self._size = 0
        self._spare = path.with_name(path.name + ".reserve")
        self._spare_bytes = 0
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        if reserve:
            self._set_aside(FIRST_RESERVE)

    def write(self, data: bytes) -> int:
        """Write all of the bytes, out of the reserve if need be.

        Raises:
            DiskFullError: Neither disk nor reserve has room; the file is as long as before.
        """
        start = self._size
        view = memoryview(data)
        while len(view):
            try:
                written = os.write(self._descriptor, view)
            except OSError as error:
                if error.errno not in FULL:
                    raise
                if self._release(os.strerror(error.errno)):
                    continue
                os.ftruncate(self._descriptor, start)
                os.lseek(self._descriptor, start, os.SEEK_SET)
                self._size = start
                raise DiskFullError(error.errno, os.strerror(error.errno), str(self.path)) from None
            view = view[written:]
            self._size += written
        self._grow()
        return len(data)

    def tell(self) -> int:
        """Bytes written so far."""
        return self._size

    def flush(self) -> None:
        """Nothing is kept back: every write is the operating system's at once."""

    def close(self) -> None:
        """Close the file and give the reserve back."""
        self._release("")
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def _grow(self) -> None:
        # The index at the end of the file grows with it.
        wanted = FIRST_RESERVE + int(RESERVE_SHARE * self._size)
        if self._spare_bytes and not self.full and wanted > 2 * self._spare_bytes:
            self._set_aside(wanted)

    def _set_aside(self, size: int) -> None:
        try:
            descriptor = os.open(self._spare, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                os.posix_fallocate(descriptor, 0, size)
            finally:
                os.close(descriptor)
            self._spare_bytes = size
        except OSError as error:
            if error.errno in FULL:
                self.full = self.full or os.strerror(error.errno)
            if not self._spare_bytes:
                with contextlib.suppress(OSError):
                    self._spare.unlink()
            # Elsewhere (file systems that cannot set space aside) there is no reserve, and a full
            # disk cuts the index.

    def _release(self, why: str) -> bool:
        self.full = self.full or why
        if not self._spare_bytes:
            with contextlib.suppress(OSError):
                self._spare.unlink()
            return False
        self._spare_bytes = 0
        with contextlib.suppress(OSError):
            self._spare.unlink()
        return True
