from __future__ import annotations

import threading

import pytest

from anynet.errors import AnyNetError
from anynet.scheduler import SIZES, Latency, LatencyTable, check_flags


def test_flags() -> None:
    check_flags("f", confidence=False, left_right=False, other=True)
    with pytest.raises(AnyNetError, match="f: expected other as True or False, got 1"):
        check_flags("f", confidence=True, left_right=True, other=1)
    with pytest.raises(AnyNetError, match="f: expected left_right together with confidence"):
        check_flags("f", confidence=False, left_right=True)
    with pytest.raises(TypeError, match="left_right"):
        check_flags("f", confidence=True)  # type: ignore[call-arg]


def test_a_latency_is_the_second_slowest_of_the_recent_ones() -> None:
    latency = Latency()
    assert latency.expected(unknown=7.0) == 7.0
    latency.measured(3.0)
    assert latency.expected(unknown=7.0) == 3.0
    for seconds in (2.0, 9.0, 1.0):
        latency.measured(seconds)
    assert latency.expected(unknown=7.0) == 3.0
    for _ in range(Latency.RECENT):
        latency.measured(1.0)
    assert latency.expected(unknown=7.0) == 1.0


def test_after_long_patience_it_hopes_again() -> None:
    latency = Latency()
    latency.measured(1.0)
    for _ in range(2):
        latency.measured(50.0)
    for _ in range(Latency.PATIENCE):
        assert latency.expected(unknown=60.0) == 50.0
        latency.skipped()
    assert latency.expected(unknown=60.0) == 1.0
    latency.measured(2.0)
    assert latency.expected(unknown=60.0) == 2.0  # what was slow is forgotten


def test_the_sizes_seen_most_recently_are_kept() -> None:
    table = LatencyTable(stages=4)
    first = table[0, 0]
    for size in range(1, SIZES):
        assert len(table[size, 0].stages) == 4
    assert table[0, 0] is first
    for size in range(10 * SIZES):
        table[size, 1]
        assert len(table) <= SIZES
        assert table[0, 0] is first
    assert len(table) == SIZES


def test_threads_may_meet_in_it() -> None:
    table = LatencyTable(stages=1)
    failed: list[BaseException] = []

    def look() -> None:
        try:
            for i in range(5000):
                table[i % (2 * SIZES)].enlarging.measured(1.0)
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=look) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    assert len(table) <= SIZES + len(threads)
