"""Rendered stereo pairs with exact ground truth."""

from anynet.synthetic.renderer import MIXTURE, render
from anynet.synthetic.scenes import PRESETS

__all__ = ["MIXTURE", "PRESETS", "render"]
