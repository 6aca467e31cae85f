"""Bags and MCAP files to read, written by rosbags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

START = 1_700_000_000_000_000_000


class BagWriter:
    """Writes one bag: `.bag` (ROS 1), `.mcap`, or a folder (ROS 2).

    Args:
        compression: bz2 or lz4 of a `.bag`, storage of `.mcap`, message or file of a folder.
    """

    def __init__(self, path: Path, compression: str = "") -> None:
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2
        from rosbags.typesys import Stores, get_typestore

        self.path = path
        self.ros = 1 if path.suffix == ".bag" else 2
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros == 1 else Stores.ROS2_JAZZY)
        self.folder = path.with_name(path.name + ".folder") if path.suffix == ".mcap" else path
        plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
        self.writer: Any = Writer1(path) if self.ros == 1 else Writer2(self.folder, version=9, storage_plugin=plugin)
        if compression and self.ros == 1:
            self.writer.set_compression(Writer1.CompressionFormat[compression.upper()])
        elif compression:
            self.writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
        self.topics: dict[str, Any] = {}

    def __enter__(self) -> BagWriter:
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()
        if self.path.suffix == ".mcap":
            (self.folder / f"{self.folder.name}.mcap").rename(self.path)

    def new(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, stamp: int, frame_id: str) -> Any:
        time = self.new("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        sequence = {"seq": 7} if self.ros == 1 else {}
        return self.new("std_msgs/msg/Header", stamp=time, frame_id=frame_id, **sequence)

    def write(self, topic: str, message: Any, recorded: int) -> None:
        kind = message.__msgtype__
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.ros == 1 else self.store.serialize_cdr
        self.writer.write(self.topics[topic], recorded, serialize(message, kind))

    def image(
        self,
        topic: str,
        image: np.ndarray,
        stamp: int,
        encoding: str = "rgb8",
        recorded: int | None = None,
        **change: Any,
    ) -> None:
        """An image as it is stored, [H, W, C] of the encoding's dtype."""
        fields = {
            "header": self.header(stamp, "eye"),
            "height": image.shape[0],
            "width": image.shape[1],
            "encoding": encoding,
            "is_bigendian": 0,
            "step": image.strides[0],
            "data": np.ascontiguousarray(image).view(np.uint8).reshape(-1),
        }
        message = self.new("sensor_msgs/msg/Image", **(fields | change))
        self.write(topic, message, stamp if recorded is None else recorded)

    def compressed(
        self, topic: str, image: np.ndarray, stamp: int, data: bytes | None = None, format: str = "png"
    ) -> None:
        """An image, RGB or gray, as PNG."""
        stored = image[..., ::-1] if image.ndim == 3 else image
        png = cv2.imencode(".png", stored)[1].reshape(-1) if data is None else np.frombuffer(data, np.uint8)
        header = self.header(stamp, "eye")
        self.write(topic, self.new("sensor_msgs/msg/CompressedImage", header=header, format=format, data=png), stamp)

    def camera_info(
        self,
        topic: str,
        size: tuple[int, int],
        matrix: np.ndarray,
        distortion: Sequence[float],
        rotation: np.ndarray,
        projection: np.ndarray,
    ) -> None:
        matrices = {"d": np.array(distortion, np.float64)}
        matrices |= {"k": np.ravel(matrix), "r": np.ravel(rotation), "p": np.ravel(projection)}
        named = {name.upper() if self.ros == 1 else name: np.float64(value) for name, value in matrices.items()}
        roi = self.new("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        fields = {"width": size[0], "height": size[1], "distortion_model": "plumb_bob", "binning_x": 0, "binning_y": 0}
        message = self.new("sensor_msgs/msg/CameraInfo", header=self.header(START, "eye"), roi=roi, **fields, **named)
        self.write(topic, message, START)
