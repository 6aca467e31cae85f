from __future__ import annotations

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from anynet import AnyNet, AnyNetConfig
from anynet.errors import AnyNetError
from anynet.network import (
    Convolution,
    Hourglass,
    PreActivation,
    Update,
    bilinear_logits,
    convex_upsampling,
    cost_net,
    filled,
    hidden,
    mismatch,
)


@pytest.fixture
def model() -> AnyNet:
    torch.manual_seed(0)
    return AnyNet().eval()


def pair(height: int, width: int, batch: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(height * width)
    return tuple(torch.randn(batch, 3, height, width, generator=generator) for _ in range(2))


def test_the_standard_network_has_the_papers_size(model: AnyNet) -> None:
    assert sum(p.numel() for p in model.parameters()) == 43_269
    assert model.config.stages == 4
    assert model.config.stride == 16


def test_each_stage_computes_only_its_own_part(model: AnyNet) -> None:
    """Counts the multiply-adds of convolutions between one estimate and the next."""
    height, width = 64, 128
    work = 0

    def count(module: Convolution, inputs: tuple[torch.Tensor], output: torch.Tensor) -> None:
        nonlocal work
        work += output.numel() * module.weight[0].numel()

    for module in model.modules():
        if isinstance(module, Convolution):
            module.register_forward_hook(count)
    pixels = height * width
    at = {scale: pixels // scale**2 for scale in (1, 2, 4, 8, 16)}
    unet_down = 27 * at[1] + 9 * at[2] + 9 * (2 + 4) * at[4] + 9 * (8 + 16) * at[8] + 9 * (32 + 64) * at[16]
    expected = [
        2 * unet_down + 12 * 27 * (16 + 4 * 256 + 16) * at[16],
        2 * 9 * (48 + 16) * at[8] + 5 * 27 * (4 + 4 * 16 + 4) * at[8],
        2 * 9 * (12 + 4) * at[4] + 5 * 27 * (4 + 4 * 16 + 4) * at[4],
        9 * (48 + 256 + 256 + 384 + 8 + 8) * at[4],
    ]
    estimates = model.stages(*pair(height, width))
    assert work == 0
    for stage in range(4):
        next(estimates)
        assert work == expected[stage], f"stage {stage + 1}"
        work = 0


@pytest.mark.parametrize(("height", "width"), [(1, 1), (5, 7), (16, 16), (33, 70), (47, 95)])
def test_any_size_gives_estimates_of_that_size(model: AnyNet, height: int, width: int) -> None:
    with torch.no_grad():
        estimates = model(*pair(height, width, batch=2))
    assert [e.shape for e in estimates] == [(2, 1, height, width)] * 4
    assert all(e.isfinite().all() for e in estimates)


def test_batch_entries_are_independent(model: AnyNet) -> None:
    left, right = pair(32, 64, batch=3)
    with torch.no_grad():
        together = model(left, right)
        alone = model(left[1:2], right[1:2])
    for a, b in zip(together, alone, strict=True):
        torch.testing.assert_close(a[1:2], b, rtol=1e-4, atol=1e-3)


def test_padding_reaches_no_further_than_the_receptive_field(model: AnyNet) -> None:
    """What lies beyond the right and bottom border does not change the estimates far from it."""
    left, right = pair(370, 500)
    beyond = [torch.nn.functional.pad(image, (0, 12, 0, 14), value=3.0) for image in (left, right)]  # to 384 x 512
    with torch.no_grad():
        for stage, (a, b) in enumerate(zip(model(left, right), model(*beyond), strict=True), start=1):
            height = 150 if stage < 4 else 50  # the left-to-right scan also carries values up, a row per column
            torch.testing.assert_close(a[..., :height, :50], b[..., :height, :50], rtol=1e-4, atol=1e-3)
            assert not torch.equal(a[..., -1, :], b[..., 369, :500])


def test_training_reaches_every_parameter() -> None:
    torch.manual_seed(0)
    model = AnyNet()
    estimates = model(*pair(64, 128, batch=2))
    torch.stack([e.square().mean() for e in estimates]).sum().backward()
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all(), name
        assert parameter.grad.abs().max() > 0, name


def test_reversed_residuals_are_the_other_direction_of_search() -> None:
    """With weights that are symmetric along the tested disparities, the two conventions differ only in sign."""
    torch.manual_seed(0)
    plain, reverse = AnyNet().eval(), AnyNet(AnyNetConfig(reversed_residuals=True)).eval()
    for module in plain.cost_nets.modules():
        if isinstance(module, Convolution):
            module.weight.data = (module.weight.data + module.weight.data.flip(2)) / 2
    reverse.load_state_dict(plain.state_dict())
    with torch.no_grad():
        first, second = plain(*pair(64, 128), stages=2)
        _, reversed_second = reverse(*pair(64, 128), stages=2)
    assert (second - first).abs().max() > 0.05
    torch.testing.assert_close(reversed_second - first, first - second, rtol=1e-4, atol=1e-3)


def test_input_scale_is_enlarging_the_images(wild_model: AnyNet) -> None:
    """Reducing the enlarged result is exact but where a kink of the last enlargement lies between the two pixels."""
    config = wild_model.config.with_input_scale(2)
    assert config.ranges == ((0, 23), (-2, 2), (-2, 2))
    assert config.with_input_scale(1) == wild_model.config
    fine = AnyNet(replace(config, ranges=wild_model.config.ranges)).eval()
    fine.load_state_dict(wild_model.state_dict())
    images = pair(40, 72)
    with torch.no_grad():
        expected = wild_model(*(F.interpolate(image, scale_factor=2, mode="bilinear") for image in images), stages=2)
        for estimate, large in zip(fine(*images), expected, strict=False):
            torch.testing.assert_close(estimate, F.avg_pool2d(large, 2) / 2, rtol=1e-4, atol=1e-3)


def test_groups_of_equal_weight_are_one(wild_model: AnyNet) -> None:
    """The sum over groups of what each group's channels cost is what all channels cost."""
    groups = AnyNet(replace(wild_model.config, groups=2)).eval()
    state = groups.state_dict()
    for name, value in wild_model.state_dict().items():
        state[name] = value.expand(state[name].shape)  # the first layers of the disparity networks have two inputs
    groups.load_state_dict(state)
    images = pair(48, 80, batch=2)
    with torch.no_grad():
        for one, two in zip(wild_model(*images), groups(*images), strict=True):
            torch.testing.assert_close(two, one, rtol=1e-4, atol=1e-3)


def test_the_hourglass_begins_as_the_identity_and_reaches_far() -> None:
    """Of the cost network of the first stage, by its response to one cell of the volume."""
    torch.manual_seed(0)
    plain = cost_net(1, 4, layers=4).eval()
    deep = cost_net(1, 4, layers=4, hourglass=2).eval()
    hourglass = next(i for i, module in enumerate(deep) if isinstance(module, Hourglass))
    assert hourglass == len(plain) // 2
    for i, layer in enumerate(plain):
        deep[i if i < hourglass else i + 1].load_state_dict(layer.state_dict())
    empty, one = torch.zeros(2, 1, 1, 12, 5, 64)
    one[0, 0, 6, 2, 8] = 1
    with torch.no_grad():
        torch.testing.assert_close(deep(one), plain(one))

        def reach(net: nn.Module) -> int:
            return int(torch.where(net(one) != net(empty))[4].max()) - 8

        assert reach(plain) == len(plain)
        for module in deep.modules():
            if isinstance(module, Hourglass):
                nn.init.normal_(module.last.conv.weight)
        assert reach(deep) > 20


def test_finer_costs_and_guided_channels_begin_as_the_identity(wild_model: AnyNet) -> None:
    """And then they reach the first estimate: the finer costs from both images, the gates from the left one."""
    options = replace(wild_model.config, hourglass=1, finer_costs=True, guided=True)
    torch.manual_seed(0)
    model = AnyNet(options).eval()
    for module in model.modules():
        if isinstance(module, Hourglass):
            nn.init.normal_(module.last.conv.weight)
    plain = AnyNet(replace(options, finer_costs=False, guided=False)).eval()
    plain.load_state_dict({name: value for name, value in model.state_dict().items() if name in plain.state_dict()})
    images = pair(48, 80)
    with torch.no_grad():
        expected = plain(*images, 1)[0]
        assert torch.equal(model(*images, 1)[0], expected)
        gates = [module.gate for module in model.modules() if isinstance(module, PreActivation) and module.gate]
        assert len(gates) == 3  # two, and one in the hourglass
        assert model.finer_costs is not None
        for layer in (*gates, model.finer_costs.conv):
            nn.init.normal_(layer.weight)
            assert not torch.equal(model(*images, 1)[0], expected)
            nn.init.zeros_(layer.weight)


def test_an_update_takes_what_costs_least() -> None:
    """A residual of its own estimate, or what a neighbour says, however far away that is."""
    update = Update(4, 8, groups=2, span=(-1, 2), radius=1).eval()
    features = torch.randn(2, 4, 3, 9, generator=torch.Generator().manual_seed(0))
    disparity = torch.full((1, 1, 3, 9), 7.0)
    disparity[..., 1, 4] = 50
    disparity[..., 1, 7] = 1

    def chosen(k: int) -> torch.Tensor:
        costs = torch.full((1, 6, 3, 9), 100.0)
        costs[:, k] = 0
        update.layers = nn.Sequential(nn.Identity())
        update.layers.register_forward_hook(lambda *_: costs)
        return update(features, disparity)

    for k in range(4):
        torch.testing.assert_close(chosen(k), disparity + k - 1)
    near, far = disparity.clone(), disparity.clone()
    near[..., 3:6], near[..., 1, 7] = 50, 7
    far[..., 6:9], far[..., 1, 4] = 1, 7
    torch.testing.assert_close(chosen(4), near)
    torch.testing.assert_close(chosen(5), far)


def test_an_update_sees_what_its_neighbours_disparities_cost() -> None:
    """A strip 10 pixels nearer, which the estimate has in its middle column only: beside that, the largest fits."""
    update = Update(4, 8, groups=2, span=(-1, 1), radius=2).eval()
    right = torch.randn(1, 4, 5, 40, generator=torch.Generator().manual_seed(0))
    left = right.roll(2, 3)
    left[..., 18:23] = right.roll(12, 3)[..., 18:23]
    disparity = torch.full((1, 1, 5, 40), 2.0)
    disparity[..., 20] = 12
    seen = []
    update.layers.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    with torch.no_grad():
        update(torch.cat([left, right]), disparity)
    (picture,) = seen
    assert picture.shape == (1, 2 * 5 + 4 + 2, 5, 40)
    own, near, far = (picture[:, channels].sum(1) for channels in ([1, 4], [6, 7], [8, 9]))  # both groups of each
    assert (near[..., 18:23] == 0).all()
    assert (own[..., 20] == 0).all()
    assert (own[..., [18, 19, 21, 22]] > 0.1).all()
    assert (far[..., 24:30] == 0).all()
    assert torch.equal(picture[:, 10:14], left)
    assert (picture[:, 14, :, 18:23] == torch.tensor([10.0, 10, 0, 10, 10])).all()
    assert (picture[:, 15, :, 18:23] == torch.tensor([0.0, 0, -10, 0, 0])).all()


def test_the_guide_shows_where_the_images_do_not_match() -> None:
    right, _ = pair(12, 40)
    left = torch.roll(right, 5, dims=3)
    disparity = torch.full((1, 1, 12, 40), 5.0)
    disparity[..., 6:, :] = 3
    difference, scaled = mismatch(left, right, disparity)
    assert difference.shape == (1, 3, 12, 40)
    assert (difference[..., :6, 5:] == 0).all()
    assert (difference[..., :6, :5] == -left[..., :6, :5]).all()  # the right camera does not see these
    assert (difference[..., 6:, 5:].abs() > 1e-3).float().mean() > 0.99
    assert torch.equal(scaled, disparity / 16)


def test_convex_upsampling_takes_what_the_logits_say() -> None:
    x = torch.arange(20.0).view(1, 1, 4, 5)
    logits = torch.zeros(1, 4, 8, 4, 5)
    logits[:, 1, 4] = 100  # the upper right one of the four: the right neighbour
    logits[:, 2, 1] = 100  # the lower left one: the one above
    logits[:, 3] = -100  # the lower right one: itself
    out = convex_upsampling(x, logits.view(1, 32, 4, 5))
    assert out.shape == (1, 1, 8, 10)
    torch.testing.assert_close(out[..., ::2, 1::2], torch.cat([x[..., 1:], x[..., -1:]], 3))
    torch.testing.assert_close(out[..., 1::2, ::2], torch.cat([x[..., :1, :], x[..., :-1, :]], 2))
    torch.testing.assert_close(out[..., 1::2, 1::2], x)
    around = F.avg_pool2d(F.pad(x, (1, 1, 1, 1), mode="replicate"), 3, 1)
    torch.testing.assert_close(out[..., ::2, ::2], around)


def test_convex_upsampling_begins_as_nearly_bilinear() -> None:
    x, _ = pair(7, 9)
    x = x[:, :1]
    out = convex_upsampling(x, bilinear_logits().view(1, 32, 1, 1).expand(1, 32, 7, 9))
    bilinear = F.interpolate(x, scale_factor=2, mode="bilinear")
    assert 0 < (out - bilinear).abs().max() < 0.2 * bilinear.std()
    model = AnyNet(replace(AnyNetConfig(), spn_upsampling=True)).eval()
    seen = []
    model.refinement.reduce.register_forward_hook(lambda *args: seen.append(args[2]))
    with torch.no_grad():
        *_, last = model(*pair(64, 96))
    (refined,) = seen
    rough = F.interpolate(refined, scale_factor=4, mode="bilinear")
    assert (last - rough).abs().mean() < 0.1 * rough.std()


def test_an_upsampling_refinement_sees_the_image_at_twice_the_finest_resolution() -> None:
    """Two images that are one at the finest features' resolution still guide it differently."""
    config = replace(AnyNetConfig(), input_scale=2, spn_upsampling=True)
    model = AnyNet(config).eval()
    seen = []
    model.refinement.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    left, right = pair(32, 48)
    with torch.no_grad():
        model(left, right)
    (guide,) = seen
    assert torch.equal(F.pixel_shuffle(guide, 2), left)


def scene() -> tuple[torch.Tensor, torch.Tensor]:
    """A wall at disparity 4, before it a post at 10 in columns 20 to 25; and what the right camera sees of it."""
    disparity = torch.full((1, 1, 3, 40), 4.0)
    disparity[..., 20:26] = 10
    seen = torch.ones_like(disparity, dtype=torch.bool)
    seen[..., :4] = False  # beyond the border
    seen[..., 14:20] = False  # the post lands on columns 10 to 15, where the wall's 14 to 19 do
    return disparity, seen


def test_the_estimate_itself_says_what_is_hidden() -> None:
    disparity, seen = scene()
    outside, behind = hidden(disparity)
    assert (outside[..., :5] == torch.tensor([1, 1, 1, 0.5, 0])).all()  # columns 0 to 3 land on -4 to -1
    assert (behind[..., 14:20] == torch.tensor([0, 0.25, 0.75, 1, 1, 1])).all()  # 0 to 5 right of the post's edge
    assert (torch.maximum(outside, behind)[seen] == 0).all()


def test_what_is_hidden_takes_the_background() -> None:
    """Whatever the estimate says there, as long as it leaves them hidden."""
    truth, _ = scene()
    wrong = truth.clone()
    wrong[..., 18:20] = 5
    wrong[..., :2] = 9
    torch.testing.assert_close(filled(4 * wrong, 4), 4 * truth)


def test_filling_passes_the_gradient_to_the_background() -> None:
    disparity, _ = scene()
    disparity.requires_grad_()
    filled(disparity, 1)[..., 17].sum().backward()
    assert disparity.grad is not None
    # 17 takes all of 16, which takes 3/4 of 15, which takes 1/4 of 14
    assert (disparity.grad[..., 14:18] == torch.tensor([0.1875, 0.5625, 0.25, 0])).all()


def test_the_refinement_begins_with_what_is_filled(wild_model: AnyNet) -> None:
    model = AnyNet(replace(wild_model.config, spn_fill=True)).eval()
    model.load_state_dict(wild_model.state_dict())
    images = pair(48, 80)
    seen = []
    model.refinement.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[1]))
    with torch.no_grad():
        *_, third, _ = model(*images)
    rough = F.interpolate(third, scale_factor=1 / 4, mode="bilinear")
    assert hidden(rough / 4)[1].mean() > 0.01
    torch.testing.assert_close(seen, [filled(rough, 4)], rtol=1e-4, atol=1e-3)


def test_hidden_pixels_vary_smoothly_with_the_estimate() -> None:
    """So that rounding, and training, do not make masks jump."""
    disparity, _ = scene()
    step = torch.randn(disparity.shape, generator=torch.Generator().manual_seed(0)) * 1e-4
    for before, after in zip(hidden(disparity), hidden(disparity + step), strict=True):
        assert (after - before).abs().max() < 1e-3


@pytest.mark.parametrize("combine", ["max", "mean"])
def test_other_shapes_of_network(combine: str) -> None:
    config = AnyNetConfig(
        channels=2,
        blocks=1,
        layers=1,
        cost_channels=(3, 2),
        cost_layers=0,
        ranges=((0, 7), (-1, 1)),
        spn_channels=4,
        spn_directions=(0, 1, 2, 3),
        spn_combine=combine,
    )
    with torch.no_grad():
        estimates = AnyNet(config).eval()(*pair(20, 30))
    assert [e.shape for e in estimates] == [(1, 1, 20, 30)] * 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"blocks": 1}, "cost_channels for each of 2 stages"),
        ({"input_scale": 3}, "input_scale 1 or 2, got 3"),
        ({"channels": 0}, "channels >= 1, got 0"),
        ({"groups": 3}, "groups to divide the finest features' 2 channels, got 3"),
        ({"hourglass": -1}, "hourglass >= 0, got -1"),
        ({"neighbours": -1}, "neighbours >= 0, got -1"),
        ({"neighbours": 1, "reversed_residuals": True}, "no neighbours with reversed_residuals"),
        ({"cost_layers": -1}, "cost_layers >= 0, got -1"),
        ({"ranges": ((0, 11), (2, -2), (-2, 2))}, "first <= last"),
        ({"spn_directions": (0, 0)}, "distinct"),
        ({"spn_directions": ()}, "spn_directions"),
        ({"spn_combine": "sum"}, "'max' or 'mean', got 'sum'"),
    ],
)
def test_impossible_configurations(options: dict[str, object], message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        AnyNetConfig(**options)


def test_errors_name_what_came(model: AnyNet) -> None:
    left, right = pair(16, 16)
    with pytest.raises(AnyNetError, match=r"stages from 1 to 4, got 5"):
        model(left, right, stages=5)
    with pytest.raises(AnyNetError, match=r"\[1, 3, 16, 16\] and \[1, 3, 16, 15\]"):
        model(left, right[..., :15])
    with pytest.raises(AnyNetError, match=r"one shape \[N, 3, H, W\]"):
        model(left[0], right[0])
