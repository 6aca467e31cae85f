"""The formats of calibration files, one reader each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from anynet.camera.document import Document
from anynet.camera.formats import kitti, middlebury, opencv, text
from anynet.camera.formats.found import Found, Request


@dataclass(frozen=True)
class Format:
    """A format of calibration files.

    Attributes:
        name: for messages.
        files: how many files one calibration has, at most.
        unit: of its lengths; empty if the files have none, and are taken as meters.
        recognizes: whether these documents, all of a calibration or some, are of this format.
        read: what they say. Raises AnyNetError if something is damaged, lacking, or contradictory.
    """

    name: str
    files: int
    unit: str
    recognizes: Callable[[Sequence[Document]], bool]
    read: Callable[[Sequence[Document], Request], Found]


# The first that recognizes the documents reads them: those with names of their own before OpenCV's.
FORMATS = (
    Format("KITTI", 1, "m", kitti.recognizes, kitti.read),
    Format("Middlebury", 1, "mm", middlebury.recognizes, middlebury.read),
    Format("K.txt", 1, "m", text.recognizes, text.read),
    Format("OpenCV", 2, "", opencv.recognizes, opencv.read),
)
