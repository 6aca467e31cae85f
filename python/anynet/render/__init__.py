"""Rendered stereo pairs with exact ground truth."""

from anynet.render.renderer import MIXTURE, RenderedSample, render
from anynet.render.scenes import MAX_DISPARITY, PRESETS

__all__ = ["MAX_DISPARITY", "MIXTURE", "PRESETS", "RenderedSample", "render"]
