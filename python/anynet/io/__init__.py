"""Files: images, disparity maps, depth maps and point clouds."""

from anynet.io.depth import read_depth, write_depth
from anynet.io.disparity import read_disparity, write_disparity
from anynet.io.files import write_atomically
from anynet.io.images import read_image, read_pair, write_image
from anynet.io.pointcloud import write_ply

__all__ = [
    "read_depth",
    "read_disparity",
    "read_image",
    "read_pair",
    "write_atomically",
    "write_depth",
    "write_disparity",
    "write_image",
    "write_ply",
]
