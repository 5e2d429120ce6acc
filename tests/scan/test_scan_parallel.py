"""Shared work gives the same rows, also when a copy dies; sorting by packed keys is stable."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanrender.scan import parallel
from scanrender.scan.parallel import Aside, fill_rows, run
from scanrender.scan.topology import edges_of, sorted_order


@pytest.fixture
def two_cores(monkeypatch):
    monkeypatch.setattr(parallel, "workers", lambda: 2)


def squares(start, stop):
    rows = np.arange(start, stop)
    return rows**2, np.stack([rows, -rows], axis=1).astype(np.float32)


@pytest.mark.parametrize("count", [0, 1, 10, 1003])
def test_rows_are_filled_in_order(two_cores, count):
    one, two = fill_rows(count, [((), np.int64), ((2,), np.float32)], squares, 10)
    np.testing.assert_array_equal(one, np.arange(count) ** 2)
    assert two.shape == (count, 2)
    np.testing.assert_array_equal(two[:, 1], -np.arange(count))


def test_copies_share_the_work(two_cores):
    (owner,) = fill_rows(40, [((), np.int64)], lambda i, j: [np.full(j - i, os.getpid())], 10)
    assert len(set(owner.tolist())) == 2
    assert os.getpid() in owner


def test_rows_of_a_copy_that_dies_are_done_here(two_cores):
    here = os.getpid()

    def work(start, stop):
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        return [np.arange(start, stop)]

    (rows,) = fill_rows(30, [((), np.int64)], work, 7)
    np.testing.assert_array_equal(rows, np.arange(30))


def test_an_error_of_a_copy_is_raised_here(two_cores):
    def fail():
        raise ValueError("asked to fail")

    with pytest.raises(ValueError, match="asked to fail"):
        run([lambda: 1, fail])
    with pytest.raises(ValueError, match="asked to fail"):
        Aside(fail).result()
    assert run([lambda: 1, lambda: {"two": 2}]) == [1, {"two": 2}]


@given(st.lists(st.integers(0, 2**62), max_size=60), st.integers(0, 60))
def test_sorted_order_is_numpys_stable_order(keys, shift):
    keys = np.array(keys, np.int64) >> shift
    np.testing.assert_array_equal(sorted_order(keys), np.argsort(keys, kind="stable"))


def test_edges_are_those_of_np_unique():
    faces = np.random.default_rng(0).integers(0, 40, (200, 3))
    edges = edges_of(faces)
    start, end = faces.T.reshape(-1), faces[:, [1, 2, 0]].T.reshape(-1)
    both = np.sort(np.stack([start, end], axis=1), axis=1)
    pairs, half, count = np.unique(both, axis=0, return_inverse=True, return_counts=True)
    np.testing.assert_array_equal(edges.pairs, pairs)
    np.testing.assert_array_equal(edges.half, half.reshape(-1))
    np.testing.assert_array_equal(edges.count, count)


@pytest.mark.parametrize(
    ("quota", "cores"),
    [("max 100000", 8), ("200000 100000", 2), ("150000 100000", 2), ("10000 100000", 1),
     ("6400000 100000", 8), ("", 8), ("what", 8), (None, 8)],
)  # fmt: skip
def test_a_container_has_the_cores_that_it_has_the_time_of(
    quota: str | None, cores: int, tmp_path: Path, monkeypatch
):
    file = tmp_path / "cpu.max"
    if quota is not None:
        file.write_text(f"{quota}\n")
    monkeypatch.setattr(parallel, "CGROUP_CPU", file)
    monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    monkeypatch.delenv(parallel.THREADS, raising=False)
    assert parallel.all_cores() == parallel.cores() == cores
    monkeypatch.setenv(parallel.THREADS, "3")
    assert parallel.all_cores() == cores
    assert parallel.cores() == min(cores, 3)
