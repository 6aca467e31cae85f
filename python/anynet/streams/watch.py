"""A stream's frames prepared: the first one is looked at closely, the others now and then."""

from __future__ import annotations

from anynet.camera import PairPreparation, PreparedPair, RowWatch
from anynet.streams.source import Frame


class WatchedPreparation:
    """Prepares the frames of a stream, in order.

    Args:
        prepare: the first frame; the others with what it found.
        watch: look at the others too.
    """

    def __init__(self, prepare: PairPreparation, watch: bool) -> None:
        self._prepare = prepare
        self._watch = RowWatch() if watch else None
        self._first = True

    def __call__(self, frame: Frame) -> tuple[PreparedPair, list[str]]:
        """The pair, and what looks wrong that was not told of the frames before."""
        pair = self._prepare(frame.left, frame.right)
        if self._first:
            self._first = False
            self._prepare = self._prepare.following(pair)
            if any("unrectified" in warning for warning in pair.warnings):
                self._watch = None  # it is told
            return pair, list(pair.warnings)
        if self._watch is None:
            return pair, []
        finding = self._watch(pair.left, pair.right, pair.calibration, pair.min_disparity)
        return pair, [finding] if finding else []
