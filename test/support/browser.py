"""A real browser for tests of the page: Debian's chromium, driven by playwright."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from tool_input.browser.chromium import chromium, missing
from tool_input.browser.window import Window

if TYPE_CHECKING:
    from playwright.sync_api import Browser


class Windows:
    """Windows of one browser, each of a person of its own."""

    def __init__(self, browser: Browser) -> None:
        """Begin with none."""
        self._browser = browser

    def open(self, address: str) -> Window:
        """A window in which the organ is drawn."""
        window = self.empty()
        window.open(address)
        window.wait_drawn()
        return window

    def empty(self) -> Window:
        """A window that shows nothing yet."""
        return Window(self._browser)


@contextmanager
def windows() -> Iterator[Windows]:
    """A browser, closed at the end; skips the test where there is none."""
    if missing():
        pytest.skip(missing())
    with chromium() as browser:
        yield Windows(browser)
