"""Left and right images of a recording that belong together."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right, insort
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

_WAIT = 5 * 10**9  # nanoseconds of the recording that an image waits for its partner: drivers may be late
_HOLD = _WAIT // 20  # ... and that newer pairs wait for it
_WAITING, _WAITING_BYTES = 1000, 2**29  # images of one camera that wait, at most


@dataclass(frozen=True, eq=False)
class Recorded:
    """An image's message; times in nanoseconds."""

    stamp: int
    recorded: int
    size: int
    message: Any


Pair = tuple[Recorded, Recorded]


class Pairing:
    """Pairs images as they come, in whatever order: those that are each other's nearest by their stamps.

    A pair is settled when both cameras have gone on, so that nothing nearer is to come, or when its images wait no
    longer. It waits a little for older images without partners, so that pairs come out by their stamps.

    Args:
        slop: nanoseconds that two may be apart.

    Attributes:
        lost: how many left and right images found no partner.
        closest: nanoseconds between the nearest two stamps.
    """

    def __init__(self, slop: int) -> None:
        self.lost = [0, 0]
        self.closest = math.inf
        self._slop = slop
        self._waiting: tuple[list[Recorded], list[Recorded]] = [], []  # by stamp
        self._pairs: list[Pair] = []  # by the left stamp
        self._last = [-math.inf, -math.inf]
        self._until = -math.inf  # stamp up to which both cameras have gone on

    def add(self, side: int, image: Recorded) -> list[Pair]:
        """Takes a left (0) or right (1) image; returns the pairs whose turn it is."""
        insort(self._waiting[side], image, key=_stamp)
        self._last[side] = image.stamp
        if (nearest := _nearest(self._waiting[1 - side], image)) is not None:
            self.closest = min(self.closest, abs(nearest.stamp - image.stamp))
        before, self._until = self._until, min(self._last)
        self._settle(min(before, self._until, image.stamp) - self._slop)
        for own, waiting in enumerate(self._waiting):
            for other in [other for other in waiting if image.recorded - other.recorded > _WAIT]:
                if other in waiting:  # not paired with the one before
                    self._give_up(own, other)
        pairs = self._released(image.recorded)
        while self._too_many() and any(self._waiting):
            self._give_up_oldest()
            pairs += self._released(image.recorded)
        return pairs

    def rest(self) -> list[Pair]:
        """The last pairs, when no image comes any more."""
        self._until = math.inf
        self._settle(-math.inf)
        while any(self._waiting):
            self._give_up_oldest()
        return self._released(0)

    def _settle(self, since: float) -> None:
        """Makes pairs of those that are each other's nearest; since that stamp something is new."""
        lefts, rights = self._waiting
        found = True
        while found:
            found = False
            for left in lefts[bisect_left(lefts, since, key=_stamp) : bisect_right(lefts, self._until, key=_stamp)]:
                right = _nearest(rights, left)
                if right is None or right.stamp > self._until or abs(right.stamp - left.stamp) > self._slop:
                    continue
                if _nearest(lefts, right) is left:
                    self._join(left, right)
                    found, since = True, min(since, left.stamp - 2 * self._slop)  # where others now are nearest

    def _join(self, left: Recorded, right: Recorded) -> None:
        self._waiting[0].remove(left)
        self._waiting[1].remove(right)
        insort(self._pairs, (left, right), key=_left_stamp)

    def _give_up(self, side: int, image: Recorded) -> None:
        """Takes an image that waits no longer with what is its nearest now, or as lost."""
        own, others = self._waiting[side], self._waiting[1 - side]
        partner = _nearest(others, image)
        if partner and abs(partner.stamp - image.stamp) <= self._slop and _nearest(own, partner) is image:
            self._join(*((image, partner) if side == 0 else (partner, image)))
        else:
            own.remove(image)
            self.lost[side] += 1

    def _give_up_oldest(self) -> None:
        side = min((side for side in (0, 1) if self._waiting[side]), key=lambda side: self._waiting[side][0].stamp)
        self._give_up(side, self._waiting[side][0])

    def _released(self, now: int) -> list[Pair]:
        waiting = (image for images in self._waiting for image in images)
        oldest = min((image.stamp for image in waiting if now - image.recorded <= _HOLD), default=math.inf)
        count = sum(left.stamp <= oldest for left, _ in self._pairs)
        pairs, self._pairs = self._pairs[:count], self._pairs[count:]
        return pairs

    def _too_many(self) -> bool:
        for side, waiting in enumerate(self._waiting):
            sizes = [image.size for image in (*waiting, *(pair[side] for pair in self._pairs))]
            if len(sizes) > _WAITING or (len(sizes) > 1 and sum(sizes) > _WAITING_BYTES):
                return True
        return False


def _nearest(others: Sequence[Recorded], image: Recorded) -> Recorded | None:
    """By its stamp; the older of two."""
    place = bisect_left(others, image.stamp, key=_stamp)
    return min(others[max(0, place - 1) : place + 1], key=lambda other: abs(other.stamp - image.stamp), default=None)


def _stamp(image: Recorded) -> int:
    return image.stamp


def _left_stamp(pair: Pair) -> int:
    return pair[0].stamp
