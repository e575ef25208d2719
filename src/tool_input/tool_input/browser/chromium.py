"""Debian's chromium, headless, drawing without a graphics card."""

from __future__ import annotations

import importlib.util
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ARGUMENTS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
"""WebGL by SwiftShader, on the processor: the same wherever it runs."""


def missing() -> str:
    """What has to be installed before a page can be opened, and how; empty: nothing."""
    if shutil.which("chromium") is None:
        return "no chromium: `apt-get install chromium`"
    if importlib.util.find_spec("playwright") is None:
        return "no playwright, which drives chromium: `pip install playwright`"
    return ""


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser, closed with all its windows at the end.

    Raises:
        ValueError: Chromium or playwright is not installed.
    """
    if missing():
        raise ValueError(missing())
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=shutil.which("chromium"), headless=True, args=list(ARGUMENTS)
        )
        try:
            yield browser
        finally:
            browser.close()
