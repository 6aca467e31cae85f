"""The formats of calibration files, one reader each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from anynet.camera.document import Document
from anynet.camera.formats import (
    camodocal,
    depthai,
    kalibr,
    kitti,
    middlebury,
    opencv,
    orb_slam,
    realsense,
    ros,
    text,
    zed,
)
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
    Format("ZED", 1, "mm", zed.recognizes, zed.read),
    Format("ROS camera_info", 2, "m", ros.recognizes, ros.read),
    Format("Kalibr", 2, "m", kalibr.recognizes_chain, kalibr.read_chain),
    Format("EuRoC", 2, "m", kalibr.recognizes_sensors, kalibr.read_sensors),
    Format("ORB-SLAM", 1, "m", orb_slam.recognizes, orb_slam.read),
    Format("VINS", 3, "m", camodocal.recognizes, camodocal.read),
    Format("DepthAI", 1, "cm", depthai.recognizes, depthai.read),
    Format("RealSense", 1, "m", realsense.recognizes, realsense.read),
    Format("OpenCV", 3, "", opencv.recognizes, opencv.read),
)
