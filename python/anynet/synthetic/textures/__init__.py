"""Textures, cut-out shapes and reliefs for the renderer."""

from anynet.synthetic.textures.bank import VARIANTS, relief, shape, texture
from anynet.synthetic.textures.fields import Field, Image, Rng
from anynet.synthetic.textures.patterns import SIZE
from anynet.synthetic.textures.shapes import SHAPE_SIZE, car_profile

__all__ = ["SHAPE_SIZE", "SIZE", "VARIANTS", "Field", "Image", "Rng", "car_profile", "relief", "shape", "texture"]
