"""What a surface is to the renderer."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

from anynet.synthetic.geometry import Camera, Vector, Window
from anynet.synthetic.textures import Field, Image


class Fragment(NamedTuple):
    """What a surface shows to one camera."""

    window: Window
    disparity: Field  # [h, w]
    coverage: Image  # [h, w], 255 = opaque
    paint: Callable[[Window], Image]  # colors [h, w, 3] of a part of the window; costly, so asked only for what is seen


class Surface(Protocol):
    @property
    def depth(self) -> float:
        """Sorts surfaces from back to front; baselines."""

    @property
    def hull(self) -> Vector:
        """Points [N, 3] whose convex hull holds the surface."""

    def cast(self, camera: Camera, view: int, window: Window) -> Fragment | None:
        """What a camera sees of the surface inside the window of its hull; None if nothing."""
