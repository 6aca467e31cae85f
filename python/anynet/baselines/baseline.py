"""The protocol that the baselines share: images in, estimates out, as AnyNet's."""

from __future__ import annotations

from abc import abstractmethod

import torch.nn.functional as F
from torch import Tensor, nn

from anynet.errors import AnyNetError


class Baseline(nn.Module):
    """A stereo network that is compared with AnyNet.

    Attributes:
        max_disparity: the disparities told apart are 0 up to this, in pixels of the images given.
        stride: the network computes on multiples of it; images are padded at the right and the bottom.
        loss_weights: of the estimates in training, the final one last.
    """

    stride: int
    loss_weights: tuple[float, ...]

    def __init__(self, max_disparity: int) -> None:
        super().__init__()
        if max_disparity < 1:
            raise AnyNetError(f"{type(self).__name__}: expected max_disparity >= 1, got {max_disparity}")
        self.max_disparity = max_disparity

    def forward(self, left: Tensor, right: Tensor) -> list[Tensor]:
        """The estimates, each [N, 1, H, W] in pixels: left pixel (y, x) is right pixel (y, x - d).

        In training, as many as `loss_weights`; in eval mode the final one alone.

        Args:
            left, right: [N, 3, H, W], RGB in 0..1, minus the ImageNet mean, over its standard deviation; any H and W.

        Raises:
            AnyNetError: if the images are not of one shape [N, 3, H, W].
        """
        if left.shape != right.shape or left.dim() != 4 or left.shape[1] != 3 or 0 in left.shape[2:]:
            raise AnyNetError(
                f"{type(self).__name__}: expected two images of one shape [N, 3, H, W], "
                f"got {list(left.shape)} and {list(right.shape)}"
            )
        height, width = left.shape[2:]
        padding = (0, -width % self.stride, 0, -height % self.stride)
        if any(padding):
            left, right = (F.pad(image, padding, mode="replicate") for image in (left, right))
        estimates = self.estimates(left, right)
        return [estimate[..., :height, :width] for estimate in estimates]

    @abstractmethod
    def estimates(self, left: Tensor, right: Tensor) -> list[Tensor]:
        """`forward` of images whose sizes are multiples of `stride`."""

    def candidates_at(self, scale: int) -> int:
        """How many disparities 0, 1, ... cover the range where one pixel is `scale` of the images'."""
        return -(-self.max_disparity // scale)
