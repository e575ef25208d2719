"""`tissue run` and the operating table: what is started, and on which address."""

from __future__ import annotations

from pathlib import Path

import pytest

from tissue_sim.runner import RunOptions, plan_run
from tissue_sim.session import process_specs
from tool_input.page_guard import check_host


def options(out: Path, headless: bool = False, bind: str = "") -> RunOptions:
    return RunOptions(
        scene="wall", units="", fixed="", model="", kind="", headless=headless, frames=10,
        seconds=0.0, procedure=None, out=out, bag=False, record_state_hz=10.0, recording=False,
        viewer=False, bind=bind,
    )  # fmt: skip


def test_the_page_listens_where_it_is_told_to_and_only_there(tmp_path: Path) -> None:
    here = process_specs(plan_run(options(tmp_path))[0])["table"].command
    assert not any("host" in word for word in here)
    everywhere = process_specs(plan_run(options(tmp_path, bind="0.0.0.0"))[0])["table"].command
    assert "host:=0.0.0.0" in everywhere
    assert "table" not in process_specs(plan_run(options(tmp_path, headless=True))[0])


@pytest.mark.parametrize("host", ["192.0.2.1", "::ffff:1:2:3:4:5:6:7"])
def test_an_address_of_no_machine_or_another_one_is_refused(host: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"allowed: 127\.0\.0\.1"):
        plan_run(options(tmp_path / "not made", bind=host))
    assert not (tmp_path / "not made").exists()


def test_an_address_needs_a_page(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="--headless"):
        plan_run(options(tmp_path / "not made", headless=True, bind="0.0.0.0"))


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0", "localhost"])
def test_addresses_of_this_machine_are_taken(host: str) -> None:
    check_host(host)
