from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tissue_sim.geometry.incidence import Incidence, sorted_unique


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_rewiring_in_one_go_equals_removing_and_adding_one_by_one(seed: int) -> None:
    random = np.random.default_rng(seed)
    tets = np.stack([random.choice(12, 4, replace=False) for _ in range(30)]).astype(np.int32)
    at_once = Incidence.build(tets, np.ones(30, dtype=np.bool_), 40)
    one_by_one = copy.deepcopy(at_once)
    for _ in range(5):
        items = random.choice(30, random.integers(1, 30), replace=False).astype(np.int32)
        new = np.stack([random.choice(40, 4, replace=False) for _ in items]).astype(np.int32)
        old = tets[items].copy()
        at_once.rewire(items, old, new)
        for item, before, after in zip(items.tolist(), old.tolist(), new.tolist(), strict=True):
            for node in set(before) - set(after):
                one_by_one.remove(node, item)
            for node in [n for n in after if n not in before]:
                one_by_one.add(node, item)
        tets[items] = new
        for node in range(40):
            assert np.array_equal(at_once.of(node), one_by_one.of(node))
    nodes = np.array([3, 17, 3, 39], dtype=np.int32)
    expected = np.unique(np.concatenate([at_once.of(n) for n in nodes.tolist()]))
    assert np.array_equal(at_once.of_all(nodes), expected)


def test_an_item_that_is_not_there_is_refused() -> None:
    tets = np.array([[0, 1, 2, 3]], dtype=np.int32)
    lists = Incidence.build(tets, np.ones(1, dtype=np.bool_), 8)
    with pytest.raises(KeyError, match="does not meet"):
        lists.rewire(np.array([0], dtype=np.int32), tets + 4, tets)


def test_sorted_unique_equals_numpy() -> None:
    rows = np.random.default_rng(1).integers(0, 50, 200).astype(np.int32)
    assert np.array_equal(sorted_unique(rows), np.unique(rows))
    assert len(sorted_unique(rows[:0])) == 0
