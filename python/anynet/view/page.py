"""What the page shows and asks, by viser; no computing here."""

from __future__ import annotations

import socket
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from anynet.errors import AnyNetError
from anynet.io.files import reason
from anynet.visualize import RGBImage, colorbar, colorize, disparity_image, limits_of

if TYPE_CHECKING:
    from anynet import Estimate
    from anynet.camera import Calibration

POINTS = 200_000  # of the cloud, at most: more are slow to send and to turn
PANEL = 640  # pixels that images are wide at most
MAX_DEPTH = 1e6  # meters
SCALES = ("the weights'", "0.5", "0.75", "1", "1.5", "2")

Map = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Settings:
    """What the page's controls say.

    Attributes:
        share: of the time that all stages take, 0 to 1.25; from 1.25 on there is no limit.
        input_scale: None: what the weights say.
        max_depth: meters; None: what half a pixel of error still tells to 20 %.
    """

    weights: str
    input_scale: float | None
    share: float
    left_right: bool
    min_confidence: float
    drop_occluded: bool
    max_depth: float | None


class Page:
    """A server of the page; the controls' changes set `changed`.

    Args:
        host, port: where it listens; the loopback interface cannot be reached from other machines.
        weights: names to choose from, the first one chosen.
        input_scale: chosen at first.

    Raises:
        AnyNetError: if viser is missing, or nothing can listen on the host.
    """

    def __init__(self, host: str, port: int, weights: Sequence[str], input_scale: float | None = None) -> None:
        try:
            import viser
        except ImportError:
            raise AnyNetError("the page needs viser: pip install 'anynet[view]'") from None
        self.changed = threading.Event()
        self.step = threading.Event()
        self.save = threading.Event()
        _check_host(host)
        self._server = viser.ViserServer(host=host, port=port, label="AnyNet", verbose=False)
        self._server.scene.set_up_direction("-y")  # the camera's y points down
        self._server.initial_camera.position = (0.0, 0.0, 0.0)
        self._server.initial_camera.look_at = (0.0, 0.0, 1.0)
        gui = self._server.gui
        gui.configure_theme(control_width="large")
        self._status = gui.add_markdown("waiting for the first frame")
        self._share = gui.add_slider(
            "time budget %", 0, 125, 1, 125, hint="Of the time that all stages take. At the end: no limit."
        )
        scales = list(SCALES)
        chosen = SCALES[0] if input_scale is None else f"{input_scale:g}"
        if chosen not in scales:
            scales.append(chosen)
        weights = [str(name) for name in weights]
        self._offered = tuple(weights), tuple(scales)
        self._playing = gui.add_checkbox("play", True)
        step, save = gui.add_button("step"), gui.add_button("save")
        with gui.add_folder("images"):
            self._images = {
                name: gui.add_image(np.zeros((8, 8, 3), np.uint8), label=name, format="jpeg")
                for name in ("left image", "disparity", "confidence")
            }
        with gui.add_folder("network"):
            self._weights = gui.add_dropdown("weights", list(weights), initial_value=weights[0])
            self._scale = gui.add_dropdown("input scale", scales, initial_value=chosen)
            self._left_right = gui.add_checkbox("left-right check", False)
        with gui.add_folder("what is kept"):
            self._min_confidence = gui.add_slider("min confidence", 0.0, 1.0, 0.01, 0.0)
            self._drop_occluded = gui.add_checkbox("drop occluded", True)
            self._max_depth = gui.add_number(
                "max depth, m", 0.0, min=0.0, step=0.5, hint="0: what half a pixel of error still tells to 20 %."
            )
        controls = (
            self._share, self._playing, self._weights, self._scale, self._left_right, self._min_confidence,
            self._drop_occluded, self._max_depth,
        )  # fmt: skip
        for control in controls:
            control.on_update(lambda _: self.changed.set())
        step.on_click(lambda _: self._asked(self.step))
        save.on_click(lambda _: self._asked(self.save))

    def _asked(self, event: threading.Event) -> None:
        event.set()
        self.changed.set()

    @property
    def url(self) -> str:
        """Where the page is."""
        host = self._server.get_host()
        return f"http://{f'[{host}]' if ':' in host else host}:{self._server.get_port()}"

    @property
    def playing(self) -> bool:
        """Whether new frames are to be shown as they come."""
        return bool(self._playing.value)

    def settings(self) -> Settings:
        """What is not offered, which only another client than the page can send, counts as the nearest that is."""
        weights, scales = self._offered
        scale = _one_of(scales, self._scale.value)
        return Settings(
            weights=_one_of(weights, self._weights.value),
            input_scale=None if scale == SCALES[0] else float(scale),
            share=_within(0, self._share.value, 125) / 100,
            left_right=bool(self._left_right.value),
            min_confidence=_within(0, self._min_confidence.value, 1),
            drop_occluded=bool(self._drop_occluded.value),
            max_depth=_within(0, self._max_depth.value, MAX_DEPTH) or None,
        )

    def tell(self, text: str) -> None:
        """A line of Markdown above the controls."""
        self._status.content = text

    def show(self, left: RGBImage, estimate: Estimate, kept: Map, limits: tuple[float, float] | None = None) -> None:
        """The images.

        Args:
            kept: the disparity [H, W], NaN where it is not to be trusted.
        """
        self._images["left image"].image = _small(left)
        self._images["disparity"].image = disparity_image(_small(kept), limits or limits_of(estimate.disparity))
        if estimate.confidence is not None:
            small = _small(estimate.confidence)
            bar = colorbar(len(small), (0.0, 1.0), "right", "blue-red")
            self._images["confidence"].image = np.hstack([colorize(small, (0.0, 1.0), "blue-red"), bar])

    def show_cloud(self, points: Map, colors: RGBImage, calibration: Calibration) -> None:
        """The cloud of points [M, 3], meters, and their colors [M, 3]."""
        if len(points) > POINTS:
            chosen = np.random.default_rng(0).choice(len(points), POINTS, replace=False)
            points, colors = points[chosen], colors[chosen]
        size = 1.5 * float(np.median(points[:, 2])) / calibration.focal if len(points) else 0.01
        self._server.scene.add_point_cloud(
            "/cloud", points, colors, point_size=size, precision="float32", point_shape="square", point_shading="flat"
        )

    def close(self) -> None:
        self._server.stop()


def _one_of(offered: tuple[str, ...], value: str) -> str:
    return value if value in offered else offered[0]


def _within(low: float, value: float, high: float) -> float:
    return min(max(low, float(value)), high)  # low for NaN, as every comparison with it is false


def _small(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """An image or a map, at most as wide as the panel."""
    height, width = values.shape[:2]
    if width <= PANEL:
        return values
    interpolation = cv2.INTER_AREA if values.dtype == np.uint8 else cv2.INTER_NEAREST
    small: npt.NDArray[Any] = cv2.resize(
        values, (PANEL, max(1, round(height * PANEL / width))), interpolation=interpolation
    )
    return small


def _check_host(host: str) -> None:
    """viser waits for ever for a server that cannot listen."""
    try:
        family, *_ = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        socket.create_server((host, 0), family=family).close()
    except (OSError, UnicodeError) as error:
        raise AnyNetError(f"cannot listen on the host {host}: {reason(error)}") from error
