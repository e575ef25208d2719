"""The command that draws pictures of the repair says what it needs."""

from __future__ import annotations

from pathlib import Path

import pytest

from viz_bridge import repair_pictures


@pytest.mark.parametrize(("args", "status"), [(["--help"], 0), ([], 2), (["only-a-bag"], 2)])
def test_the_command_says_what_it_needs(
    args: list[str], status: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        repair_pictures.main(args)
    assert ended.value.code == status
    said = capsys.readouterr()
    assert "repair_pictures [-h] bag folder" in said.out + said.err


def test_a_bag_that_cannot_be_read_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        repair_pictures.main([str(tmp_path / "no.mcap"), str(tmp_path)])
    assert ended.value.code == 2
    assert "no.mcap" in capsys.readouterr().err
