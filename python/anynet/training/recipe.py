"""What a training run is: every option, once, for Python (`Recipe`) and for the command line (made from its fields)."""

# ruff: noqa: RUF009 (_option is dataclasses.field with its help text)
from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal

from anynet.config import AnyNetConfig
from anynet.errors import AnyNetError

Schedule = Literal["constant", "step", "cosine"]


def _option(default: Any, help: str, *, manner: bool = False) -> Any:
    """A field with its help text. `manner`: says how to run, not what to learn, so it may change when resuming."""
    return field(default=default, metadata={"help": help, "manner": manner})


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """One training run. The same recipe, data and number of threads give the same weights, bit for bit.

    Lengths are in steps (optimizer updates) unless a name says epochs; sizes are (height, width) in pixels.
    """

    data: tuple[str, ...] = _option((), "Training data, LAYOUT:PATH; several are joined.")
    validation: tuple[str, ...] = _option((), "Data to measure on while training, LAYOUT:PATH.")
    weights: str | None = _option(None, "Weights to start from: a packaged name or a file. Default: random.")
    input_scale: int | None = _option(None, "2: these weights on images enlarged to twice their size. 1: not enlarged.")
    grow: bool = _option(False, "Put the weights into --network, which has all their parts; its others begin anew.")
    network: AnyNetConfig = _option(AnyNetConfig(), "Shape of the network, where the weights do not tell it.")
    steps: int | None = _option(None, "Length of the run in steps of one batch.")
    epochs: int | None = _option(None, "Length of the run in passes over the data (instead of steps).")
    batch: int = _option(6, "Pairs per step, over all processes.")
    crop: tuple[int, int] = _option((256, 512), "Height and width of the training crops.")
    augment: bool = _option(True, "Vary scale, color, noise and occlusion, not only the place of the crop.")
    rate: float = _option(2e-3, "Learning rate of Adam.")
    schedule: Schedule = _option("cosine", "Rate over the run: constant, step (a tenth after --drop-at) or cosine.")
    warm_up: int = _option(0, "Steps over which the rate grows linearly to its value.")
    drop_at: float = _option(2 / 3, "Fraction of the run after which the step schedule divides the rate by 10.")
    stage_weights: tuple[float, ...] = _option(
        (), "Weight of each stage's loss; last ones of 0 are not computed. Default: 0.25, 0.5, 1..."
    )
    robust: float = _option(
        0.0,
        "Pixels of error beyond which it counts by its logarithm alone, so that hopeless pixels teach less. 0: none.",
    )
    occluded_weight: float = _option(1.0, "Weight in the loss of pixels that the right crop does not show.")
    far_weight: float = _option(1.0, "Weight in the loss of pixels with less than 1/2 pixel of disparity: the sky.")
    clip: float = _option(5.0, "Largest norm of the gradient; longer ones are scaled down. 0: as they are.")
    averaging: float = _option(0.0, "Decay of the running average of the weights that is kept; 0 keeps the last.")
    seed: int = _option(0, "Fixes the initial weights, the order of the data and the augmentation.")
    amp: bool = _option(False, "Mixed precision (bfloat16), on CUDA.")
    device: str | None = _option(None, "cpu or cuda. Default: cuda where there is one.", manner=True)
    threads: int | None = _option(None, "CPU threads of the network. Default: PyTorch's.", manner=True)
    workers: int = _option(1, "Processes that prepare the data.", manner=True)
    log_every: int = _option(20, "Steps between two lines of the log.", manner=True)
    checkpoint_every: int = _option(200, "Steps between two checkpoints.", manner=True)
    validate_every: int | None = _option(None, "Steps between two validations. Default: at the end.", manner=True)
    tensorboard: bool = _option(False, "Write TensorBoard events as well as the log.", manner=True)

    def __post_init__(self) -> None:
        for name in ("batch", "log_every", "checkpoint_every", "validate_every", "steps", "epochs"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise AnyNetError(f"{name} must be at least 1, got {value}")
        if self.input_scale is not None and self.weights is None:
            raise AnyNetError("input_scale is for weights to start from; give a new network its own, as in network")
        if self.grow and self.weights is None:
            raise AnyNetError("grow is for weights to start from")
        if min(self.crop) < 64:
            raise AnyNetError(f"crop must be at least 64x64, got {self.crop[0]}x{self.crop[1]}")
        if not self.rate > 0:
            raise AnyNetError(f"rate must be positive, got {self.rate}")
        for name in ("occluded_weight", "far_weight"):
            if not 0 <= getattr(self, name) <= 1:
                raise AnyNetError(f"{name} must be in [0, 1], got {getattr(self, name)}")
        if not self.robust >= 0:
            raise AnyNetError(f"robust must be positive or 0, got {self.robust}")
        if not 0 <= self.averaging < 1:
            raise AnyNetError(f"averaging must be in [0, 1), got {self.averaging}")
        if self.schedule not in ("constant", "step", "cosine"):
            raise AnyNetError(f"schedule must be constant, step or cosine, got {self.schedule!r}")
        if not self.clip >= 0:
            raise AnyNetError(f"clip must be positive or 0, got {self.clip}")

    def length(self, samples: int) -> int:
        """Steps of the whole run on a data set of this many samples."""
        if (self.steps is None) == (self.epochs is None):
            raise AnyNetError("give the length of the run as either steps or epochs")
        return self.steps if self.steps is not None else math.ceil(self.epochs * samples / self.batch)  # type: ignore[operator]

    def stage_weights_of(self, stages: int) -> tuple[float, ...]:
        """One per stage."""
        weights = self.stage_weights or (0.25, 0.5, *[1.0] * (stages - 2))
        if len(weights) != stages:
            raise AnyNetError(f"stage_weights: expected {stages}, one per stage, got {len(weights)}")
        if min(weights) < 0 or not any(weights):
            raise AnyNetError(f"stage_weights: expected none below 0 and one above, got {weights}")
        return weights

    def rate_at(self, step: int, steps: int) -> float:
        """Learning rate of update `step` (from 0) of a run of `steps`."""
        warm = min(1.0, (step + 1) / (self.warm_up + 1))
        if self.schedule == "step":
            return warm * self.rate * (0.1 if step >= self.drop_at * steps else 1.0)
        if self.schedule == "cosine":
            return warm * self.rate * (1 + math.cos(math.pi * step / steps)) / 2
        return warm * self.rate

    def to_json(self) -> str:
        return json.dumps(asdict(self), indent=2) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Recipe:
        values = {name: _tuples(value) for name, value in json.loads(text).items()}
        return cls(**{**values, "network": network_of(values["network"])})

    def check_resumed(self, other: Recipe) -> None:
        """Raises AnyNetError if a run of this recipe cannot go on with `other`, because it would learn otherwise."""
        for option in fields(self):
            old, new = getattr(self, option.name), getattr(other, option.name)
            if old != new and not option.metadata["manner"]:
                raise AnyNetError(f"{option.name} was {old!r} when the run began, so it cannot be {new!r} on resuming")


LARGE = AnyNetConfig(
    channels=4,
    groups=4,
    hourglass=3,
    finer_costs=True,
    guided=True,
    cost_channels=(16, 24, 16),
    ranges=((0, 11), (-3, 3), (-2, 2)),
    neighbours=2,
    spn_fill=True,
    spn_mismatch=True,
    spn_upsampling=True,
)

ENLARGED = Recipe(
    weights="large",
    network=LARGE,
    input_scale=2,
    steps=6_500,
    batch=3,
    crop=(192, 384),
    rate=1e-3,
    warm_up=50,
    robust=3.0,
    occluded_weight=0.2,
    far_weight=0.1,
)

PRESETS: dict[str, Recipe] = {
    # The paper, section IV-A.
    "paper-sceneflow": Recipe(epochs=10, rate=5e-4, schedule="constant", augment=False, clip=0.0),
    "paper-kitti": Recipe(epochs=300, rate=5e-4, schedule="step", augment=False, clip=0.0),
    # The weights that ship; what differs from the paper, and why, is in docs/training.md.
    "default": Recipe(network=AnyNetConfig(spn_fill=True), steps=8_000, rate=2e-3, warm_up=100),
    "large": Recipe(network=LARGE, steps=7_000, batch=4, rate=2e-3, warm_up=100, occluded_weight=0.2),
    "enlarged": ENLARGED,
    "kitti": replace(ENLARGED, steps=700, warm_up=100),
}


def preset(name: str, **options: Any) -> Recipe:
    """The named preset with `options` changed. steps and epochs replace each other."""
    if name not in PRESETS:
        raise AnyNetError(f"no preset {name!r}; there are {', '.join(PRESETS)}")
    if options.get("steps") is not None:
        options.setdefault("epochs", None)
    elif options.get("epochs") is not None:
        options.setdefault("steps", None)
    return replace(PRESETS[name], **options)


def network_of(options: dict[str, Any]) -> AnyNetConfig:
    """The configuration with the given options, as JSON holds them."""
    names = [option.name for option in fields(AnyNetConfig)]
    for name in options:
        if name not in names:
            raise AnyNetError(f"network: expected options among {', '.join(names)}, got {name!r}")
    return AnyNetConfig(**{name: _tuples(value) for name, value in options.items()})


def _tuples(value: Any) -> Any:
    """JSON has lists only; recipes hold tuples, perhaps of tuples."""
    return tuple(_tuples(v) for v in value) if isinstance(value, list) else value
