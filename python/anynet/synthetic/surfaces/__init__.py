"""Textured surfaces, seen by either camera of a rectified pair."""

from anynet.synthetic.surfaces.patch import Patch
from anynet.synthetic.surfaces.quadric import Quadric
from anynet.synthetic.surfaces.relief import Relief
from anynet.synthetic.surfaces.surface import Fragment, Surface

__all__ = ["Fragment", "Patch", "Quadric", "Relief", "Surface"]
