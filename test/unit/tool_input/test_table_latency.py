"""Which times belong to one move of the mouse, on sessions written down by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tool_input.table_latency import PARTS, PageNotes, ToolNotes, photons, quantiles

REST, PULLED = np.zeros(3), np.array([0.3, 0.0, 0.0])


def session(
    start: float, parts: tuple[float, ...], back: bool = False
) -> tuple[PageNotes, ToolNotes]:
    """One move at a time, with so many seconds for each part, among what happens besides."""
    sent, posed, applied, arrived, drawn = (start + at for at in np.cumsum(parts))
    old, new = (PULLED, REST) if back else (REST, PULLED)
    page = PageNotes(
        [sent],
        # Batches without motion come all the time, one just before the one that counts.
        [(start - 0.01, old), (arrived - 0.005, old), (arrived, new), (arrived + 0.02, new)],
        # The tool is drawn before the tissue follows.
        [sent + 0.001, drawn, drawn + 0.03],
    )
    tool = ToolNotes(
        # A hand that rests repeats its pose.
        [(start - 0.02, old), (sent, old), (posed, new), (posed + 0.01, new)],
        [(start - 0.02, start), (posed, applied), (posed + 0.01, applied + 0.016)],
    )
    return page, tool


def joined(
    one: tuple[PageNotes, ToolNotes], two: tuple[PageNotes, ToolNotes]
) -> tuple[PageNotes, ToolNotes]:
    (a, b), (c, d) = one, two
    page = PageNotes(a.sent + c.sent, a.places + c.places, a.changed + c.changed)
    return page, ToolNotes(b.poses + d.poses, b.frames + d.frames)


def test_each_part_is_the_time_that_was_put_in() -> None:
    first, second = (0.002, 0.008, 0.016, 0.050, 0.030), (0.004, 0.006, 0.010, 0.040, 0.020)
    page, tool = joined(session(10.0, first), session(11.0, second, back=True))
    found = photons([10.0, 11.0], page, tool, least=0.1)
    np.testing.assert_allclose([each.parts() for each in found], np.array([first, second]) * 1e3,
                               atol=1e-6)  # fmt: skip
    summary = quantiles(found)
    assert list(summary) == ["whole", *PARTS]
    assert summary["whole"]["p50"] == pytest.approx((106 + 80) / 2)
    assert summary["node out"]["p50"] == pytest.approx(45.0)


def test_a_move_whose_picture_came_after_the_next_move_is_left_out() -> None:
    slow, quick = (0.002, 0.008, 0.016, 0.050, 1.5), (0.002, 0.008, 0.016, 0.050, 0.030)
    page, tool = joined(session(10.0, slow), session(11.0, quick, back=True))
    page = PageNotes(page.sent, page.places, sorted(page.changed)[-3:])
    assert [each.moved for each in photons([10.0, 11.0], page, tool, least=0.1)] == [11.0]


def test_tissue_that_does_not_move_is_no_photon() -> None:
    page, tool = session(10.0, (0.002, 0.008, 0.016, 0.050, 0.030))
    assert photons([10.0], page, tool, least=0.5) == []
    with pytest.raises(ValueError, match="no move"):
        quantiles([])
