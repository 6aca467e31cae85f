"""Cameras: their calibrations, from any tool's files, and the rectification of their images."""

from anynet.camera.calibration import Calibration
from anynet.camera.read import read_calibration
from anynet.camera.rig import Camera, Rectification, StereoRig

__all__ = ["Calibration", "Camera", "Rectification", "StereoRig", "read_calibration"]
