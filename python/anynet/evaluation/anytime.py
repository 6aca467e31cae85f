"""The anytime setting (arXiv 1810.11408, section IV-B): whoever asks at time t gets the last map finished by then.

A method is a sequence of maps with the times at which they were finished; a `Curve` is their error against time, a
step at each completion.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise, product
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from anynet.errors import AnyNetError
from anynet.evaluation.evaluate import Evaluation
from anynet.evaluation.metrics import Disparity, Mask, d1

FIRST_MS, LAST_MS = 5.0, 1000.0
"""The range of times that counts by default."""

NOTHING = 100.0
"""Error before the first map is finished: every pixel is wrong."""

Map = TypeVar("Map")


@dataclass(frozen=True)
class Curve:
    """Error against time.

    Args:
        milliseconds: when maps were finished, from the start of the frame; never falling.
        errors: of those maps, in the metric's unit.
        nothing: error before the first of them.

    Raises:
        AnyNetError: if there are no maps, as many times as errors are not given, or times fall.
    """

    milliseconds: tuple[float, ...]
    errors: tuple[float, ...]
    nothing: float = NOTHING

    def __post_init__(self) -> None:
        times = self.milliseconds
        if not times or len(times) != len(self.errors):
            raise AnyNetError(f"Curve: expected as many times as errors, got {len(times)} and {len(self.errors)}")
        if not all(0 < before <= after for before, after in zip((times[0], *times), times, strict=False)):
            raise AnyNetError(f"Curve: expected times above 0 that never fall, got {times}")

    def at(self, milliseconds: float) -> float:
        """Error of the last map finished by then."""
        finished = bisect_right(self.milliseconds, milliseconds)
        return self.errors[finished - 1] if finished else self.nothing

    def area(self, first_ms: float = FIRST_MS, last_ms: float = LAST_MS) -> float:
        """Mean error over times from `first_ms` to `last_ms`, uniform in their logarithm.

        That is the area under the curve over the logarithm of time, divided by its width.

        Raises:
            AnyNetError: unless 0 < first_ms < last_ms.
        """
        if not 0 < first_ms < last_ms:
            raise AnyNetError(f"area: expected 0 < first_ms < last_ms, got {first_ms} and {last_ms}")
        inside = [time for time in self.milliseconds if first_ms < time < last_ms]
        edges = [first_ms, *inside, last_ms]
        total = sum(self.at(begin) * math.log(end / begin) for begin, end in pairwise(edges))
        return total / math.log(last_ms / first_ms)

    def wasted(self, queries: Iterable[float]) -> float:
        """Milliseconds of work that is thrown away if the method is stopped at a query's time: the mean over queries.

        That is the time since the last map was finished, or since the start; none once the last map of all is there.

        Raises:
            AnyNetError: if there are no queries.
        """
        lost = []
        for query in queries:
            finished = bisect_right(self.milliseconds, query)
            begun = self.milliseconds[finished - 1] if finished else 0.0
            lost.append(0.0 if finished == len(self.milliseconds) else query - begun)
        if not lost:
            raise AnyNetError("wasted: expected at least one query, got none")
        return sum(lost) / len(lost)


def random_queries(
    count: int, seed: int = 0, first_ms: float = FIRST_MS, last_ms: float = LAST_MS
) -> npt.NDArray[np.float64]:
    """[count] times in milliseconds, uniform in their logarithm."""
    exponents = np.random.default_rng(seed).uniform(math.log(first_ms), math.log(last_ms), count)
    times: npt.NDArray[np.float64] = np.exp(exponents)
    return times


def curve_of(
    maps: Iterable[tuple[Disparity, float]],
    truth: Disparity,
    mask: Mask,
    metric: Callable[[Disparity, Disparity, Mask], float] = d1,
) -> Curve:
    """The curve of one pair.

    Args:
        maps: disparity [H, W] in pixels, and the milliseconds after which it was finished, in order.
        truth, mask: [H, W], the pixels that count.
        metric: error of (prediction, truth, mask).
    """
    times, errors = [], []
    for disparity, milliseconds in maps:
        times.append(float(milliseconds))
        errors.append(metric(disparity, truth, mask))
    return Curve(tuple(times), tuple(errors))


def curve_of_stages(evaluation: Evaluation, metric: str = "d1") -> Curve:
    """The curve of a method's stages over a data set: median times, and errors as mean over images."""
    return Curve(
        tuple(stage.milliseconds for stage in evaluation.stages),
        tuple(float(getattr(stage.mean, metric)) for stage in evaluation.stages),
    )


def one_after_another(runs: Iterable[tuple[Map, float]]) -> list[tuple[Map, float]]:
    """Completions of methods that run one after another: of (result, how long it took), (result, when it was finished).

    The paper has its baselines compete so: each at rising resolutions, as nothing of one run helps the next.
    """
    now = 0.0
    finished = []
    for result, milliseconds in runs:
        now += milliseconds
        finished.append((result, now))
    return finished


def mean_curve(curves: Sequence[Curve]) -> Curve:
    """Error at each time as the mean over curves: of several pairs, or of several splits.

    Raises:
        AnyNetError: if there are no curves.
    """
    if not curves:
        raise AnyNetError("mean_curve: expected at least one curve, got none")
    times = sorted({time for curve in curves for time in curve.milliseconds})
    errors = tuple(sum(curve.at(time) for curve in curves) / len(curves) for time in times)
    return Curve(tuple(times), errors, sum(curve.nothing for curve in curves) / len(curves))


def cascade(curves: Sequence[Curve]) -> Curve:
    """The curve of methods that run one after another, stages and all.

    A map that is worse than one before it, as the first of a slower method may be, is not handed out.

    Raises:
        AnyNetError: if there are no curves.
    """
    if not curves:
        raise AnyNetError("cascade: expected at least one curve, got none")
    start = 0.0
    times: list[float] = []
    errors: list[float] = []
    for curve in curves:
        times += [start + time for time in curve.milliseconds]
        errors += curve.errors
        start = times[-1]
    return Curve(tuple(times), tuple(accumulate(errors, min)), curves[0].nothing)


def best_cascade(curves: Mapping[str, Curve]) -> list[tuple[str, int]]:
    """Which methods to run one after another, and each to which stage, for the smallest `area`.

    Tries every choice of stages; those chosen run in the order of their time.

    Args:
        curves: by name of the method.

    Returns: names, in order of running, and numbers of stages.

    Raises:
        AnyNetError: if there are none, or more than 100,000 choices.
    """
    choices = math.prod(len(curve.milliseconds) + 1 for curve in curves.values())
    if not 2 <= choices <= 100_000:
        raise AnyNetError(f"best_cascade: expected 2 to 100,000 choices of stages, got {choices}")

    def run(chosen: tuple[int, ...]) -> list[tuple[str, int, Curve]]:
        cut = [
            (name, stages, Curve(curve.milliseconds[:stages], curve.errors[:stages], curve.nothing))
            for (name, curve), stages in zip(curves.items(), chosen, strict=True)
            if stages
        ]
        return sorted(cut, key=lambda method: method[2].milliseconds[-1])

    every = product(*(range(len(curve.milliseconds) + 1) for curve in curves.values()))
    runs = (run(chosen) for chosen in every if any(chosen))
    best = min(runs, key=lambda methods: cascade([curve for _, _, curve in methods]).area())
    return [(name, stages) for name, stages, _ in best]
