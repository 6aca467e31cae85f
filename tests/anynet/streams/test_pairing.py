from __future__ import annotations

import numpy as np
import pytest

from anynet.streams import pairing
from anynet.streams.pairing import Pairing, Recorded

MS = 1_000_000


def paired(images: list[tuple[str, int, int]], slop: int = 10) -> tuple[list[tuple[int, int]], list[int]]:
    """Stamps of the pairs that come of images, each side, stamp and time of recording; and how many are lost."""
    found = Pairing(slop * MS)
    pairs = []
    for side, stamp, recorded in sorted(images, key=lambda image: image[2]):
        pairs += found.add("lr".index(side), Recorded(stamp * MS, recorded * MS, 100, None))
    pairs += found.rest()
    return [(left.stamp // MS, right.stamp // MS) for left, right in pairs], found.lost


def test_images_out_of_order() -> None:
    lefts = [("l", 0, 0), ("l", 33, 33), ("l", 66, 66)]
    rights = [("r", 33, 70), ("r", 0, 71), ("r", 66, 72)]
    assert paired(lefts + rights) == ([(0, 0), (33, 33), (66, 66)], [0, 0])


def test_the_nearest_and_not_the_first() -> None:
    images = [("r", -15, 0), ("l", 0, 1), ("r", 1, 2), ("l", 16, 17), ("r", 17, 18)]
    assert paired(images, slop=20) == ([(0, 1), (16, 17)], [0, 1])
    images = [("l", 0, 0), ("r", 12, 1), ("l", 13, 2), ("r", -9, 3)]  # whose nearest is another's
    assert paired(images, slop=20) == ([(0, -9), (13, 12)], [0, 0])


def test_the_same_stamps_twice() -> None:
    assert paired([("l", 5, 0), ("l", 5, 0), ("r", 5, 0), ("r", 5, 0), ("l", 5, 1)]) == ([(5, 5)] * 2, [1, 0])


def test_a_clock_that_is_put_back() -> None:
    images = [(side, stamp, recorded) for recorded, stamp in enumerate((1000, 1033, 0, 33)) for side in "lr"]
    assert paired(images) == ([(1000, 1000), (1033, 1033), (0, 0), (33, 33)], [0, 0])


@pytest.mark.parametrize("seed", range(5))
def test_shutters_that_differ_and_delays_at_random(seed: int) -> None:
    rng = np.random.default_rng(seed)
    images, expected = [], []
    for index in range(100):
        left, right = 33 * index, 33 * index + int(rng.integers(-8, 9))
        images += [("l", left, left), ("r", right, right + int(rng.integers(0, 200)))]
        expected.append((left, right))
    assert paired(images) == (expected, [0, 0])


def test_a_lost_image_holds_the_others_up_for_a_quarter_of_a_second() -> None:
    found = Pairing(10 * MS)
    count = 0
    for stamp in range(0, 7000, 100):
        for side in (0, 1) if stamp else (0,):
            count += len(found.add(side, Recorded(stamp * MS, stamp * MS, 1, None)))
        assert count == (0 if stamp <= 250 else stamp // 100)
    assert found.lost == [1, 0]


@pytest.mark.parametrize("ahead", [-1, 0, 1])
def test_pauses_longer_than_images_wait(ahead: int) -> None:
    """The left image comes first, with the later stamp or not: its partner is there when it waits no longer."""
    images = [
        (side, 6000 * k + 10 + ahead * (side == "r"), 6000 * k + (side == "r")) for k in range(9) for side in "lr"
    ]
    pairs, lost = paired(images)
    assert (len(pairs), lost) == (9, [0, 0])


def test_a_camera_that_ends_loses_no_pair() -> None:
    images = [("l", 33 * k, 33 * k) for k in range(300)] + [("r", 33 * k - 1, 33 * k + 1) for k in range(100)]
    pairs, lost = paired(images)
    assert (len(pairs), lost) == (100, [200, 0])


@pytest.mark.parametrize(("bound", "value"), [("_WAITING", 20), ("_WAITING_BYTES", 2000)])
def test_what_waits_is_bounded(monkeypatch: pytest.MonkeyPatch, bound: str, value: int) -> None:
    """Also pairs that wait for an older image."""
    monkeypatch.setattr(pairing, bound, value)
    found = Pairing(10 * MS)
    for stamp in range(100):
        for side in (0, 1) if stamp else (1,):
            found.add(side, Recorded(100 * stamp * MS, stamp * MS, 100, None))
            assert sum(map(len, found._waiting)) + 2 * len(found._pairs) <= 2 * 21
    assert found.lost == [0, 1]
