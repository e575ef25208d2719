"""The `tissue` command in the test's own process."""

from __future__ import annotations

import sys

import pytest

from tissue_sim.cli import main


def tissue(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Run the command: exit code, output and errors. Whoever calls it restores sys.argv."""
    sys.argv = ["tissue", *arguments]
    code = 0
    try:
        main()
    except SystemExit as ended:
        code = int(ended.code or 0)
    said = capsys.readouterr()
    return code, said.out, said.err
