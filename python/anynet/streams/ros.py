"""ROS messages from and to arrays, by `rosbags` (extra `ros`); no ROS is needed."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from anynet.camera import Calibration, StereoRig
from anynet.camera.document import Document
from anynet.camera.formats import ros as camera_info
from anynet.camera.formats.found import Request
from anynet.camera.plausibility import check_baseline
from anynet.camera.tree import Tree
from anynet.errors import AnyNetError
from anynet.io.images import decode_levels
from anynet.streams.source import Image

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

IMAGE, COMPRESSED, CAMERA_INFO = (
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/CameraInfo",
)
DISPARITY, CLOUD = "stereo_msgs/msg/DisparityImage", "sensor_msgs/msg/PointCloud2"

# OpenCV names Bayer patterns by the second row's second and third pixel, ROS by the first row's first two.
_BAYER = {
    "bayer_rggb": cv2.COLOR_BayerBG2RGB,
    "bayer_bggr": cv2.COLOR_BayerRG2RGB,
    "bayer_gbrg": cv2.COLOR_BayerGR2RGB,
    "bayer_grbg": cv2.COLOR_BayerGB2RGB,
}
# sensor_msgs/image_encodings.h: dtype, channels, and how OpenCV makes RGB of it (None: it is, or gray)
_ENCODINGS: Mapping[str, tuple[type, int, int | None]] = {
    "rgb8": (np.uint8, 3, None),
    "bgr8": (np.uint8, 3, cv2.COLOR_BGR2RGB),
    "8UC3": (np.uint8, 3, cv2.COLOR_BGR2RGB),
    "rgba8": (np.uint8, 4, cv2.COLOR_RGBA2RGB),
    "bgra8": (np.uint8, 4, cv2.COLOR_BGRA2RGB),
    "8UC4": (np.uint8, 4, cv2.COLOR_BGRA2RGB),
    "mono8": (np.uint8, 1, None),
    "8UC1": (np.uint8, 1, None),
    "rgb16": (np.uint16, 3, None),
    "bgr16": (np.uint16, 3, cv2.COLOR_BGR2RGB),
    "mono16": (np.uint16, 1, None),
    "16UC1": (np.uint16, 1, None),
    **{f"{name}8": (np.uint8, 1, code) for name, code in _BAYER.items()},
    **{f"{name}16": (np.uint16, 1, code) for name, code in _BAYER.items()},
    "yuv422": (np.uint8, 2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (np.uint8, 2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (np.uint8, 2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": (np.uint8, 2, cv2.COLOR_YUV2RGB_YUY2),
}


def require_rosbags() -> None:
    """Raises AnyNetError unless `rosbags` is installed."""
    try:
        import rosbags.typesys  # noqa: F401
    except ImportError as error:
        raise AnyNetError(f"bags and MCAP files need the extra ros: pip install 'anynet[ros]' ({error})") from error


@cache
def typestore(ros: int) -> Typestore:
    """The messages that ROS 1 or 2 comes with."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)


@cache
def _digest(ros: int, kind: str) -> str:
    return typestore(ros).generate_msgdef(kind)[1] if ros == 1 else typestore(ros).hash_rihs01(kind)


def check_digest(ros: int, kind: str, digest: str, where: str) -> None:
    """Refuses messages that are not those of ROS. Their definitions in the file are not used: `rosbags` would make code
    of them, and needs more time for it than for small images.

    Args:
        ros: 1 or 2.
        kind: one that ROS comes with.
        digest: what the file says of it; ROS 2 wrote none before Iron.
        where: the file.

    Raises:
        AnyNetError: if there is a digest, of another definition.
    """
    if digest and digest != _digest(ros, kind):
        raise AnyNetError(f"{where}: expected {kind} with digest {_digest(ros, kind)}, got {str(digest)[:80]!r}")


def deserialized(ros: int, raw: bytes, kind: str) -> Any:
    """A message of ROS 1 or 2."""
    store = typestore(ros)
    return store.deserialize_ros1(raw, kind) if ros == 1 else store.deserialize_cdr(raw, kind)


def stamp_of(message: Any) -> int:
    """The header's time, nanoseconds; 0 if the driver did not set it."""
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def levels_of(message: Any, where: str) -> npt.NDArray[Any]:
    """Of a sensor_msgs/Image or CompressedImage: gray [H, W] or RGB [H, W, 3], uint8 or uint16.

    Raises:
        AnyNetError: if the encoding is not known, or the data are not what the message says.
    """
    if message.__msgtype__ == COMPRESSED:
        levels = decode_levels(where, bytes(message.data))
        encoding = _stored_encoding(message.format)
        if not encoding.startswith("bayer_") or (levels.ndim == 3 and (levels != levels[..., :1]).any()):
            return levels
        mosaic = levels if levels.ndim == 2 else levels[..., 0].copy()  # gray images are decoded to three channels
        return _converted(mosaic, encoding, where)
    if message.encoding not in _ENCODINGS:
        raise AnyNetError(f"{where}: expected encoding {', '.join(_ENCODINGS)}, got {message.encoding[:40]!r}")
    dtype, channels, _ = _ENCODINGS[message.encoding]
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * np.dtype(dtype).itemsize
    if height < 1 or width < 1 or step < row or len(message.data) < step * (height - 1) + row:
        raise AnyNetError(
            f"{where}: expected {width} x {height} pixels of {message.encoding}, got {len(message.data)} bytes "
            f"in rows of {step}"
        )
    step = row if height == 1 else step  # a message's step may be anything then
    padded = np.zeros(step * height, np.uint8)  # the last row may end at its last pixel
    data = np.asarray(message.data, np.uint8)[: step * height]
    padded[: len(data)] = data
    pixels: npt.NDArray[Any] = np.ascontiguousarray(padded.reshape(height, step)[:, :row]).view(dtype)
    if dtype is np.uint16 and bool(message.is_bigendian) != (sys.byteorder == "big"):
        pixels = pixels.byteswap()
    pixels = pixels.reshape(height, width, channels) if channels > 1 else pixels.reshape(height, width)
    return _converted(pixels, message.encoding, where)


def _stored_encoding(format: str) -> str:
    """The last that image_transport names, as in "bayer_rggb8; jpeg compressed bgr8"; "" if there is none."""
    return ([""] + [word for word in format.replace(";", " ").split() if word in _ENCODINGS])[-1]


def _converted(pixels: npt.NDArray[Any], encoding: str, where: str) -> npt.NDArray[Any]:
    """Pixels of an encoding as gray or RGB."""
    code = _ENCODINGS[encoding][2]
    try:
        return pixels if code is None else cv2.cvtColor(pixels, code)
    except cv2.error as error:
        height, width = pixels.shape[:2]
        raise AnyNetError(f"{where}: {width} x {height} pixels of {encoding} make no image") from error


def calibration_of(left: Any, right: Any, where: str, rectified: bool) -> tuple[Calibration | StereoRig, list[str]]:
    """From the sensor_msgs/CameraInfo of two cameras, of raw images unless they are `rectified`; and what looks wrong.

    Raises:
        AnyNetError: if they are not calibrated, or raw images cannot be rectified.
    """
    documents = [Document(Path(where), "json", _tree(message)) for message in (left, right)]
    try:
        found = camera_info.read(documents, Request())
        if "baseline" not in found.values:
            raise AnyNetError("P[0, 3] = -focal * baseline of the right camera is 0: was each camera calibrated alone?")
        values: dict[str, Any] = {**found.values, "size": found.size, "origin": found.origin, "rig": found.rig}
        calibration = Calibration(**values)
        warnings = [*found.warnings, *check_baseline(calibration.baseline, "camera_info is in meters")]
        warnings = [f"{where}: {warning}" for warning in warnings]
        if rectified or found.rig is None:
            return calibration, warnings
        found.rig.check_skew()
        return found.rig.with_rectified(calibration), warnings
    except AnyNetError as error:
        raise AnyNetError(f"{where}: {error}") from error


def _tree(message: Any) -> dict[str, Tree]:
    def numbers(name: str) -> Tree:  # ROS 1 has upper case, ROS 2 lower
        values = getattr(message, name) if hasattr(message, name) else getattr(message, name.upper())
        return [repr(float(value)) for value in values]

    fields: dict[str, Tree] = {name: numbers(name) for name in "pkdr"}
    return fields | {name: str(getattr(message, name)) for name in ("width", "height", "distortion_model")}


class Messages:
    """Makes messages of ROS 1 or 2.

    Args:
        ros: 1 or 2.
    """

    def __init__(self, ros: int) -> None:
        require_rosbags()
        self.ros = ros
        self.store = typestore(ros)

    def serialize(self, message: Any) -> bytes:
        store = self.store
        make = store.serialize_ros1 if self.ros == 1 else store.serialize_cdr
        return bytes(make(message, message.__msgtype__))

    def header(self, stamp: int, frame_id: str) -> Any:
        time = self._new("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        sequence = {"seq": 0} if self.ros == 1 else {}
        return self._new("std_msgs/msg/Header", **sequence, stamp=time, frame_id=frame_id)

    def image(self, header: Any, values: npt.NDArray[Any], encoding: str) -> Any:
        """Values [H, W] or [H, W, C] of a dtype that is the encoding's."""
        values = np.ascontiguousarray(values)
        return self._new(
            IMAGE,
            header=header,
            height=values.shape[0],
            width=values.shape[1],
            encoding=encoding,
            is_bigendian=int(sys.byteorder == "big"),
            step=values.strides[0],
            data=values.view(np.uint8).reshape(-1),
        )

    def disparity(
        self, header: Any, disparity: npt.NDArray[np.float32], focal: float, baseline: float, least: float, most: float
    ) -> Any:
        """stereo_msgs/DisparityImage; its disparities are those of cameras with one principal point: Z = f T / d."""
        height, width = disparity.shape
        return self._new(
            DISPARITY,
            header=header,
            image=self.image(header, disparity, "32FC1"),
            f=focal,
            **{"T" if self.ros == 1 else "t": baseline},
            valid_window=self._region(width, height),
            min_disparity=least,
            max_disparity=most,
            delta_d=0.0,
        )

    def cloud(self, header: Any, points: npt.NDArray[np.float32], colors: Image) -> Any:
        """sensor_msgs/PointCloud2 of points [N, 3], meters, and their RGB [N, 3]; fields x, y, z, rgb."""
        data = np.zeros(len(points), [("xyz", "<f4", 3), ("bgr0", "u1", 4)])
        data["xyz"], data["bgr0"][:, :3] = points, colors[:, ::-1]
        names = [(name, 4 * index) for index, name in enumerate(("x", "y", "z", "rgb"))]
        fields = [self._new("sensor_msgs/msg/PointField", name=n, offset=o, datatype=7, count=1) for n, o in names]
        return self._new(
            CLOUD,
            header=header,
            height=1,
            width=len(points),
            fields=fields,
            is_bigendian=False,
            point_step=data.itemsize,
            row_step=data.nbytes,
            data=data.view(np.uint8).reshape(-1) if len(points) else np.zeros(0, np.uint8),
            is_dense=True,
        )

    def camera_info(self, header: Any, size: tuple[int, int], calibration: Calibration, right: bool) -> Any:
        """sensor_msgs/CameraInfo of one of two rectified cameras."""
        width, height = size
        cx = (width - 1) / 2 if calibration.cx is None else calibration.cx
        cy = (height - 1) / 2 if calibration.cy is None else calibration.cy
        projection = np.zeros((3, 4))
        projection[:, :3] = (
            (calibration.focal, 0, cx + right * calibration.doffs),
            (0, calibration.focal, cy),
            (0, 0, 1),
        )
        projection[0, 3] = -right * calibration.focal * calibration.baseline
        matrices = {"d": np.zeros(5), "k": projection[:, :3].reshape(-1), "r": np.eye(3).reshape(-1)}
        matrices["p"] = projection.reshape(-1)
        return self._new(
            CAMERA_INFO,
            header=header,
            height=height,
            width=width,
            distortion_model="plumb_bob",
            **{name.upper() if self.ros == 1 else name: values.copy() for name, values in matrices.items()},
            binning_x=0,
            binning_y=0,
            roi=self._region(0, 0),
        )

    def _region(self, width: int, height: int) -> Any:
        return self._new(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=height, width=width, do_rectify=False
        )

    def _new(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)
