from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from anynet import Predictor, waiting
from anynet.waiting import Waiting

Frame = Callable[[float, int], None]


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """What the threads have been told: to sleep or to spin."""
    calls: list[bool] = []

    def wait_passively(passively: bool, *, unless_told: bool) -> None:
        assert unless_told
        calls.append(passively)

    monkeypatch.setattr(waiting, "wait_passively", wait_passively)
    return calls


@pytest.fixture
def frame(monkeypatch: pytest.MonkeyPatch, told: list[bool]) -> Frame:
    """Ends a frame that took so many seconds of the processors, and was preempted so many times a second."""
    usage = [0.0, 0]
    monkeypatch.setattr(waiting, "_usage", lambda: (usage[0], usage[1]))
    subject = Waiting()

    def run(seconds: float, preemptions: int) -> None:
        usage[0] += seconds
        usage[1] += round(preemptions * seconds)
        subject.adapt()

    return run


def test_spins_while_nothing_preempts_it(frame: Frame, told: list[bool]) -> None:
    for _ in range(100):
        frame(0.05, 10)
    assert told
    assert not any(told)


def test_sleeps_beside_other_work_and_tries_again_ever_less_often(frame: Frame, told: list[bool]) -> None:
    slept, since = [], None
    for number in range(20_000):
        frame(0.05, 200)
        if told and told[-1] and since is None:
            since = number
        elif told and not told[-1] and since is not None:
            slept.append(0.05 * (number - since))
            since = None
    expected = [min(Waiting.SHORTEST * 2**n, Waiting.LONGEST) for n in range(len(slept))]
    assert slept == pytest.approx(expected, abs=0.1)
    assert slept[-1] == pytest.approx(Waiting.LONGEST, abs=0.1)


def test_sleeps_as_soon_as_a_window_has_seen_enough(frame: Frame, told: list[bool]) -> None:
    frame(0.05, 300)
    assert told == []
    frame(0.05, 300)
    assert told == [True]


def test_spins_again_when_the_other_work_has_ended(frame: Frame, told: list[bool]) -> None:
    for _ in range(10):
        frame(0.05, 200)
    assert told[-1]
    for _ in range(1000):
        frame(0.05, 1)
    assert told.count(True) == 1
    assert not told[-1]


def test_predictors_tell(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = []
    monkeypatch.setattr(Waiting, "adapt", lambda self: frames.append(self))
    image, predictor = np.zeros((16, 32, 3), np.uint8), Predictor()
    predictor.predict(image, image)
    list(Predictor("paper").stages(image, image))
    assert len(frames) == 2
    assert frames[0] is frames[1]


def test_usage_grows_with_work() -> None:
    before, _ = waiting._usage()
    np.linalg.eigvals(np.random.default_rng(0).normal(size=(200, 200)))
    assert waiting._usage()[0] > before
