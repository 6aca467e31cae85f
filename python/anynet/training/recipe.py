"""What a training run is: every option, once, for Python (`Recipe`) and for the command line (made from its fields)."""

# ruff: noqa: RUF009 (_option is dataclasses.field with its help text)
from __future__ import annotations

import json
import math
import warnings
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from anynet.errors import AnyNetError, one_line
from anynet.io.files import MAX_PIXELS, read_text
from anynet.model import presets
from anynet.model.bounds import as_tuples, check_input_scale
from anynet.model.config import AnyNetConfig
from anynet.scheduler import MAX_THREADS

Schedule = Literal["constant", "step", "cosine"]


_BOUNDS = {
    "threads": (1, MAX_THREADS),
    "workers": (0, MAX_THREADS),
    "seed": (0, 2**63 - 1),
    "warmup_steps": (0, 2**31 - 1),
    "milestone": (0, 1),
}


def _option(default: Any, help: str, *, runtime: bool = False) -> Any:
    """A field with its help text. `runtime`: says how to run, not what to learn, so it may change when resuming."""
    return field(default=default, metadata={"help": help, "runtime": runtime})


def _is(value: Any, kind: Any) -> bool:
    """Whether the value is of the annotated type; whole numbers are floats too."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return any(_is(value, one) for one in inner)
    if origin is Literal:
        return isinstance(value, str)
    if origin is tuple:
        kinds = [inner[0]] * len(value) if inner[-1] is ... and isinstance(value, (tuple, list)) else inner
        return isinstance(value, (tuple, list)) and len(value) == len(kinds) and all(map(_is, value, kinds))
    if kind in (int, float):
        return isinstance(value, (int, float) if kind is float else int) and not isinstance(value, bool)
    return isinstance(value, kind)


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """One training run. The same recipe, data and number of threads give the same weights, bit for bit.

    Lengths are in steps (optimizer updates) unless a name says epochs; sizes are (height, width) in pixels.
    """

    data: tuple[str, ...] = _option(
        (),
        "Training data, KIND:ROOT[?OPTION=VALUE&...], like rendered:DIR, folders:DIR?scale=4 (with left/, right/ and "
        "disparity/), csv:FILE?scale=1000&unit=mm (docs/data.md); several are joined.",
    )
    validation: tuple[str, ...] = _option(
        (), "Data to measure on while training, KIND:ROOT[?OPTION=VALUE&...].", runtime=True
    )
    weights: str | None = _option(None, "Weights to start from: a packaged name or a file. Default: random.")
    input_scale: float | None = _option(None, "Resize the images by this factor first. Default: what the weights say.")
    load_partial: bool = _option(
        False, "Load those weights that have their place in --network; what then lacks weights begins anew."
    )
    network: AnyNetConfig = _option(AnyNetConfig(), "Shape of the network, where the weights do not tell it.")
    model: str | None = _option(None, "A baseline of anynet.baselines.MODELS instead of AnyNet, from random weights.")
    steps: int | None = _option(None, "Length of the run in steps of one batch.")
    epochs: int | None = _option(None, "Length of the run in passes over the data (instead of steps).")
    batch_size: int = _option(6, "Pairs per step, over all processes.")
    crop_size: tuple[int, int] = _option((256, 512), "Height and width of the training crops.")
    augment: bool = _option(True, "Vary scale, color, noise and occlusion, not only the place of the crop.")
    perturb: bool = _option(
        False, "Vary also what real rigs do: rows that do not meet, exposure, noise, focus, compression."
    )
    learning_rate: float = _option(2e-3, "Learning rate of Adam.")
    schedule: Schedule = _option(
        "cosine", "Learning rate over the run: constant, step (a tenth after --milestone) or cosine."
    )
    warmup_steps: int = _option(0, "Steps over which the learning rate grows linearly to its value.")
    milestone: float = _option(
        2 / 3, "Fraction of the run after which the step schedule divides the learning rate by 10."
    )
    stage_weights: tuple[float, ...] = _option(
        (), "Weight of each stage's loss; last ones of 0 are not computed. Default: 0.25, 0.5, 1..."
    )
    smooth_below: float = _option(
        1.0, "Pixels of error below which the loss is square, so that small errors hardly teach. 1: the paper's."
    )
    robust_scale: float = _option(
        0.0,
        "Pixels of error beyond which the loss grows as the logarithm only, so that outliers teach less. 0: never.",
    )
    occluded_weight: float = _option(1.0, "Weight in the loss of pixels that the right crop does not show.")
    far_weight: float = _option(1.0, "Weight in the loss of pixels with less than 1/2 pixel of disparity: the sky.")
    max_grad_norm: float = _option(5.0, "Largest norm of the gradient, which is clipped to it. 0: not clipped.")
    ema_decay: float = _option(
        0.0, "Decay of the exponential moving average of the weights that is kept; 0 keeps the last."
    )
    seed: int = _option(0, "Fixes the initial weights, the order of the data and the augmentation.")
    amp: bool = _option(False, "Mixed precision (bfloat16), on CUDA.")
    device: str | None = _option(None, "cpu or cuda. Default: cuda where there is one.", runtime=True)
    threads: int | None = _option(None, "CPU threads of the network. Default: PyTorch's.", runtime=True)
    workers: int | None = _option(
        None, "Processes that prepare the data. Default: 1; beside a GPU one per core, up to 16.", runtime=True
    )
    log_every: int = _option(20, "Steps between two lines of the log.", runtime=True)
    checkpoint_every: int = _option(200, "Steps between two checkpoints.", runtime=True)
    validate_every: int | None = _option(None, "Steps between two validations. Default: at the end.", runtime=True)
    tensorboard: bool = _option(False, "Write TensorBoard events as well as the log.", runtime=True)

    def __post_init__(self) -> None:
        for name, kind in get_type_hints(Recipe).items():
            if not _is(getattr(self, name), kind):
                expected = kind.__name__ if isinstance(kind, type) else str(kind).replace("typing.", "")
                raise AnyNetError(f"{name}: expected {expected}, got {getattr(self, name)!r:.100}")
        for name, (low, high) in _BOUNDS.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise AnyNetError(f"{name}: expected {low} to {high}, got {value}")
        for name in ("batch_size", "log_every", "checkpoint_every", "validate_every", "steps", "epochs"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise AnyNetError(f"{name} must be at least 1, got {value}")
        if self.input_scale is not None:
            check_input_scale(self, self.input_scale)
        if self.input_scale is not None and self.weights is None and self.model is None:
            raise AnyNetError("input_scale is for weights to start from; give a new network its own, as in network")
        if self.model is not None and self.weights is not None:
            raise AnyNetError("weights are AnyNet's; a model of another name begins with random ones")
        if self.load_partial and self.weights is None:
            raise AnyNetError("load_partial is for weights to start from")
        if self.perturb and not self.augment:
            raise AnyNetError("perturb is a part of augment, which is off")
        if min(self.crop_size) < 64:
            raise AnyNetError(f"crop_size must be at least 64x64, got {self.crop_size[0]}x{self.crop_size[1]}")
        if self.crop_size[0] * self.crop_size[1] > MAX_PIXELS:
            raise AnyNetError(
                f"crop_size must have at most {MAX_PIXELS} pixels, got {self.crop_size[0]}x{self.crop_size[1]}"
            )
        if not self.learning_rate > 0:
            raise AnyNetError(f"learning_rate must be positive, got {self.learning_rate}")
        for name in ("occluded_weight", "far_weight"):
            if not 0 <= getattr(self, name) <= 1:
                raise AnyNetError(f"{name} must be in [0, 1], got {getattr(self, name)}")
        if not self.smooth_below > 0:
            raise AnyNetError(f"smooth_below must be positive, got {self.smooth_below}")
        if not self.robust_scale >= 0:
            raise AnyNetError(f"robust_scale must be positive or 0, got {self.robust_scale}")
        for name in ("learning_rate", "smooth_below", "robust_scale", "max_grad_norm"):
            if math.isinf(getattr(self, name)):
                raise AnyNetError(f"{name} must be finite, got inf")
        if not 0 <= self.ema_decay < 1:
            raise AnyNetError(f"ema_decay must be in [0, 1), got {self.ema_decay}")
        if self.schedule not in ("constant", "step", "cosine"):
            raise AnyNetError(f"schedule must be constant, step or cosine, got {self.schedule!r}")
        if self.device not in (None, "cpu", "cuda"):
            raise AnyNetError(f"device must be cpu or cuda, got {self.device!r}")
        if not self.max_grad_norm >= 0:
            raise AnyNetError(f"max_grad_norm must be positive or 0, got {self.max_grad_norm}")

    def length(self, samples: int) -> int:
        """Steps of the whole run on a data set of this many samples."""
        if (self.steps is None) == (self.epochs is None):
            raise AnyNetError("give the length of the run as either steps or epochs")
        return self.steps if self.steps is not None else math.ceil(self.epochs * samples / self.batch_size)  # type: ignore[operator]

    def stage_weights_of(self, stages: int, usual: tuple[float, ...] = ()) -> tuple[float, ...]:
        """One per stage: the recipe's, else `usual`, else AnyNet's."""
        weights = self.stage_weights or usual or (0.25, 0.5, *[1.0] * (stages - 2))
        if len(weights) != stages:
            raise AnyNetError(f"stage_weights: expected {stages}, one per stage, got {len(weights)}")
        if not all(0 <= weight < math.inf for weight in weights) or not any(weights):
            raise AnyNetError(f"stage_weights: expected finite ones, none below 0 and one above, got {weights}")
        return weights

    def learning_rate_at(self, step: int, steps: int) -> float:
        """Learning rate of update `step` (from 0) of a run of `steps`."""
        warm = min(1.0, (step + 1) / (self.warmup_steps + 1))
        if self.schedule == "step":
            return warm * self.learning_rate * (0.1 if step >= self.milestone * steps else 1.0)
        if self.schedule == "cosine":
            return warm * self.learning_rate * (1 + math.cos(math.pi * step / steps)) / 2
        return warm * self.learning_rate

    def warn_of_lengths(self, steps: int) -> None:
        """Warns of what is longer than a run of `steps`."""
        if self.warmup_steps >= steps:
            warnings.warn(
                f"warmup_steps ({self.warmup_steps}) are not fewer than the run's {steps} steps: "
                "the learning rate does not get to its full height",
                stacklevel=2,
            )
        begun = self.ema_decay**steps
        if begun > 0.1:
            warnings.warn(
                f"ema_decay {self.ema_decay:g} averages over more than the run's {steps} steps: "
                f"{100 * begun:.0f} % of the result are the weights that it begins with",
                stacklevel=2,
            )

    def to_json(self) -> str:
        return json.dumps(asdict(self), indent=2) + "\n"

    @classmethod
    def load(cls, path: Path) -> Recipe:
        """The recipe in a file of `to_json`. Those of versions with other options are refused."""
        text = read_text(path)
        try:
            values = json.loads(text)
            network = AnyNetConfig.from_dict(values.pop("network"))
            missing = {option.name for option in fields(cls)} - {"network", *values}
            if missing:
                raise ValueError(f"no {', '.join(sorted(missing))}")
            return cls(network=network, **{name: as_tuples(value) for name, value in values.items()})
        except (AttributeError, KeyError, RecursionError, TypeError, ValueError) as error:
            raise AnyNetError(
                f"{path}: expected a recipe of this version, got another file or options: {one_line(error)}"
            ) from None

    def check_resumed(self, other: Recipe) -> None:
        """Raises AnyNetError if a run of this recipe cannot go on with `other`, because it would learn otherwise."""
        for option in fields(self):
            old, new = getattr(self, option.name), getattr(other, option.name)
            if old != new and not option.metadata["runtime"]:
                longer = ""
                if option.name in ("steps", "epochs"):
                    longer = ": to train longer, begin another with `anynet finetune --weights RUN/weights.safetensors`"
                raise AnyNetError(
                    f"{option.name} was {old!r} when the run began, so it cannot be {new!r} on resuming{longer}"
                )


ENLARGED = Recipe(
    weights="large",
    network=presets.large().with_input_scale(2),
    steps=6_500,
    batch_size=3,
    crop_size=(192, 384),
    learning_rate=1e-3,
    warmup_steps=50,
    robust_scale=3.0,
    occluded_weight=0.2,
    far_weight=0.1,
)

PRESETS: dict[str, Recipe] = {
    # The paper, section IV-A.
    "paper-sceneflow": Recipe(epochs=10, learning_rate=5e-4, schedule="constant", augment=False, max_grad_norm=0.0),
    "paper-kitti": Recipe(epochs=300, learning_rate=5e-4, schedule="step", augment=False, max_grad_norm=0.0),
    # The weights that ship; what differs from the paper, and why, is in docs/ablations.md.
    "paper": Recipe(network=presets.filled(), steps=8_000, learning_rate=2e-3, warmup_steps=100),
    "default": Recipe(
        network=presets.default(),
        steps=8_000,
        learning_rate=1e-3,
        warmup_steps=100,
        perturb=True,
        robust_scale=3.0,
        occluded_weight=0.5,
        far_weight=0.2,
    ),
    "large": Recipe(
        network=presets.large(), steps=7_000, batch_size=4, learning_rate=2e-3, warmup_steps=100, occluded_weight=0.2
    ),
    "enlarged": ENLARGED,
    "kitti": replace(ENLARGED, steps=700, warmup_steps=100),
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
