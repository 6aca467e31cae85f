from __future__ import annotations

import torch
import torch.nn.functional as F
from networks import pair, with_weights_of

from anynet import AnyNet, AnyNetConfig
from anynet.model.config import RefinementConfig
from anynet.model.refinement import bilinear_logits, warp_error
from anynet_ext.reference import convex_upsampling, fill_occlusions


def test_the_warp_error_shows_where_the_images_do_not_match() -> None:
    right, _ = pair(12, 40)
    left = torch.roll(right, 5, dims=3)
    disparity = torch.full((1, 1, 12, 40), 5.0)
    disparity[..., 6:, :] = 3
    difference, scaled = warp_error(left, right, disparity)
    assert difference.shape == (1, 3, 12, 40)
    assert (difference[..., :6, 5:] == 0).all()
    assert (difference[..., :6, :5] == -left[..., :6, :5]).all()  # the right camera does not see these
    assert (difference[..., 6:, 5:].abs() > 1e-3).float().mean() > 0.99
    assert torch.equal(scaled, disparity / 16)


def test_convex_upsampling_begins_as_nearly_bilinear() -> None:
    x, _ = pair(7, 9)
    x = x[:, :1]
    out = convex_upsampling(x, bilinear_logits().view(1, 32, 1, 1).expand(1, 32, 7, 9))
    bilinear = F.interpolate(x, scale_factor=2, mode="bilinear")
    assert 0 < (out - bilinear).abs().max() < 0.2 * bilinear.std()
    model = AnyNet(AnyNetConfig(refinement=RefinementConfig(convex_upsampling=True))).eval()
    seen = []
    model.refinement.reduce.register_forward_hook(lambda *args: seen.append(args[2]))
    with torch.no_grad():
        *_, last = model(*pair(64, 96))
    (refined,) = seen
    rough = F.interpolate(refined, scale_factor=4, mode="bilinear")
    assert (last - rough).abs().mean() < 0.1 * rough.std()


def test_an_upsampling_refinement_sees_the_image_at_twice_the_finest_resolution() -> None:
    """Two images that are one at the finest features' resolution still guide it differently."""
    config = AnyNetConfig(input_scale=2, refinement=RefinementConfig(convex_upsampling=True))
    model = AnyNet(config).eval()
    seen = []
    model.refinement.guidance[0].register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    left, right = pair(32, 48)
    with torch.no_grad():
        model(left, right)
    (guide,) = seen
    assert torch.equal(F.pixel_shuffle(guide, 2), left)


def test_the_refinement_begins_with_what_is_filled(wild_model: AnyNet) -> None:
    model = with_weights_of(wild_model, refinement=RefinementConfig(fill_occlusions=True))
    images = pair(48, 80)
    seen = []
    model.refinement.expand.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    with torch.no_grad():
        *_, third, _ = model(*images)
    rough = F.interpolate(third, scale_factor=1 / 4, mode="bilinear")
    filled = fill_occlusions(rough, 4)
    assert ((filled - rough).abs() > 0.1).float().mean() > 0.01
    torch.testing.assert_close(seen, [filled], rtol=1e-4, atol=1e-3)
