"""Which stages fit into a budget of time, learned from the frames before."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Hashable
from contextlib import suppress
from functools import partial
from numbers import Integral, Real
from typing import Any, Generic, TypeVar

from anynet.errors import AnyNetError

V = TypeVar("V")

MAX_THREADS = 256  # starting many more ends the process
SIZES = 64  # kept: the most recently seen


def budget_of(caller: str, budget_ms: Any) -> float:
    """Milliseconds; None: no limit. Raises AnyNetError if it is no such number."""
    if budget_ms is None:
        return math.inf
    number = isinstance(budget_ms, Real) and not isinstance(budget_ms, bool)
    if not number or not budget_ms >= 0:
        raise AnyNetError(f"{caller}: expected budget_ms >= 0, got {budget_ms!r}")
    budget: float = budget_ms
    return budget


def last_stage_of(caller: str, stage: Any, stages: int | None, name: str = "stage") -> int | None:
    """The last stage to compute of `stages`, of which None says nothing. Raises AnyNetError if there is none such."""
    if stage is None:
        return stages
    number = isinstance(stage, Integral) and not isinstance(stage, bool)
    if not number or not 1 <= stage <= (stages or stage):
        raise AnyNetError(f"{caller}: expected {name} from 1 to {stages or 'the last'}, got {stage!r}")
    return int(stage)


def check_flags(caller: str, *, confidence: Any, left_right: Any, **others: Any) -> None:
    """Raises AnyNetError unless all are True or False, and `left_right` goes with `confidence`."""
    for name, value in {"confidence": confidence, "left_right": left_right, **others}.items():
        if not isinstance(value, bool):
            raise AnyNetError(f"{caller}: expected {name} as True or False, got {value!r}")
    if left_right and not confidence:
        raise AnyNetError(f"{caller}: expected left_right together with confidence")


class Latency:
    """Seconds that something takes, learned from the last few times.

    Without a lock: its values are never changed in place, and threads that meet lose at most a measurement.
    """

    RECENT = 16
    PATIENCE = 100  # times in a row to do without before hoping again: the machine may have been busy

    def __init__(self) -> None:
        self._recent: tuple[float, ...] = ()
        self._fastest = math.inf
        self._skips = 0

    def expected(self, unknown: float) -> float:
        """The second slowest of the recent ones, so that one hiccup rules nothing out; `unknown` if there are none."""
        if self._skips >= self.PATIENCE:
            return min(self._fastest, unknown)
        return max(sorted(self._recent)[-2:-1] or self._recent, default=unknown)

    def measured(self, seconds: float) -> None:
        before = () if self._skips >= self.PATIENCE else self._recent
        self._recent = (*before, seconds)[-self.RECENT :]
        self._fastest = min(self._fastest, seconds)
        self._skips = 0

    def skipped(self) -> None:
        self._skips += 1


class Latencies:
    """What the parts of a frame take, for one image size and number of threads."""

    def __init__(self, stages: int) -> None:
        self.stages = [Latency() for _ in range(stages)]
        self.enlarging = Latency()


class RecentlyUsed(Generic[V]):
    """Something for every key, kept for those used most recently.

    Without a lock: each step is atomic, and another thread's in between costs at most what one key's value knew.
    """

    def __init__(self, make: Callable[[], V], most: int) -> None:
        self._make, self._most = make, most
        self._values: OrderedDict[Hashable, V] = OrderedDict()

    def __getitem__(self, key: Hashable) -> V:
        try:
            value = self._values.pop(key)
        except KeyError:
            value = self._make()
        self._values[key] = value
        if len(self._values) > self._most:
            with suppress(KeyError):
                self._values.popitem(last=False)
        return value

    def __len__(self) -> int:
        return len(self._values)


class LatencyTable(RecentlyUsed[Latencies]):
    """The latencies of the image sizes seen most recently."""

    def __init__(self, stages: int) -> None:
        super().__init__(partial(Latencies, stages), SIZES)
