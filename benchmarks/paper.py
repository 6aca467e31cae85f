"""The evaluation of AnyNet's paper (arXiv 1810.11408, section IV) made anew: a command per table or figure.

python benchmarks/paper.py train --data kitti2015:DATA/kitti2015 [--pretraining SPEC] [--only PATTERN ...]
python benchmarks/paper.py table2|fig5|fig6|fig7 --data kitti2015:DATA/kitti2015 [--data kitti2012:DATA/kitti2012]

`train` makes the weights in --runs: each network first on --pretraining, then on all pairs but a split's, five times.
The others draw from them what is there: OUT/NAME.png, .json and .md. Every command goes on where it was stopped: what
is trained or measured stays, and --again measures anew. Times are measured in one run, all methods taking turns.

Networks of the baselines see the images at 1/4, 1/8 and 1/16 of their size, as in the paper; at full size they are only
timed, with random weights, and the error that their authors published is drawn as a cross.
"""

from __future__ import annotations

import hashlib
import json
import platform
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import cv2
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter
from measure import console, options, subplots, write_json
from rich.console import Console

from anynet import AnyNet, AnyNetConfig, save_checkpoint
from anynet.baselines import MODELS, BaselinePredictor, random_baseline
from anynet.checkpoint import find_weights
from anynet.data import StereoSample, open_dataset
from anynet.evaluation import opencv, report
from anynet.evaluation.anytime import FIRST_MS, LAST_MS, Curve, best_cascade, cascade, one_after_another, random_queries
from anynet.evaluation.evaluate import Image, Method, evaluate
from anynet.evaluation.methods import open_method
from anynet.evaluation.splits import draw_splits
from anynet.io import write_image
from anynet.io.files import write_atomically
from anynet.model import presets
from anynet.predictor import Estimate
from anynet.samples import Concatenation, Dataset
from anynet.training.loop import train
from anynet.training.recipe import Recipe
from anynet.training.run_folder import LOG, WEIGHTS

SPLITS = 5
SCALES = (1, 1 / 4, 1 / 8, 1 / 16)
COMMANDS = ("train", "table2", "fig5", "fig6", "fig7")

PRETRAINING = Recipe(steps=2_000, batch_size=4, learning_rate=1e-3, warmup_steps=100)
FINE_TUNING = Recipe(steps=300, batch_size=4, learning_rate=5e-4, warmup_steps=20)


@dataclass(frozen=True)
class Published:
    """A figure from a paper."""

    value: float
    source: str


# D1 in % over all pixels, of networks at the size that their authors chose.
ERRORS = {
    "psmnet": Published(2.32, "KITTI 2015 test set, PSMNet in the benchmark's list"),
    "stereonet-8x": Published(4.83, "KITTI 2015 test set, StereoNet in the benchmark's list"),
    "dispnetc": Published(4.34, "KITTI 2015 test set, DispNetC in the benchmark's list"),
    "resnet18-2d": Published(9.8, "KITTI 2015, its 200 training pairs at 513x257, stereoDNN/README of NVIDIA redtail"),
    "nvtiny": Published(11.12, "KITTI 2015, its 200 training pairs at 513x161, stereoDNN/README of NVIDIA redtail"),
}

# Milliseconds on a Jetson TX2.
TX2 = {
    "resnet18-2d": Published(110, "513x257, float32, stereoDNN/README of NVIDIA redtail"),
    "nvtiny": Published(360, "513x161, float32, stereoDNN/README of NVIDIA redtail"),
    "stereonet-8x": Published(333, "1242x375, 3 frames per second on the page of AnyNet's authors"),
}


@dataclass(frozen=True)
class PaperTable:
    """Table II of the paper: per stage, D1 in % as mean and standard deviation of five splits."""

    mean: tuple[float, ...]
    deviation: tuple[float, ...]


TABLE2 = {
    "kitti2012": PaperTable((15.1, 9.9, 6.7, 6.1), (1.1, 0.6, 0.4, 0.3)),
    "kitti2015": PaperTable((14.0, 9.7, 7.5, 6.2), (0.7, 0.7, 0.4, 0.3)),
}
TABLE2_TX2 = (28.9, 48.8, 87.9, 97.3)


@dataclass(frozen=True)
class Point:
    """One network to train and measure."""

    name: str
    label: str
    recipe: Recipe
    baseline: str | None = None


def _anynet(name: str, label: str, **changes: Any) -> Point:
    network: AnyNetConfig = presets.paper().with_options(changes)
    return Point(name, label, Recipe(network=network))


ABLATIONS = (
    _anynet("anynet", "AnyNet"),
    _anynet("separate-features", "without U-Net", **{"features.separate": True}),
    _anynet("full-range", "without residuals", **{"residual_stages.full_range": True}),
    _anynet("concatenation", "without distance-based cost volume", groups=0),
)
ANYNET = ABLATIONS[0]
SMALL_BASELINES = tuple(
    Point(
        f"{model}-{round(1 / scale)}", f"{model} at 1/{round(1 / scale)}", Recipe(model=model, input_scale=scale), model
    )
    for model in MODELS
    for scale in SCALES[1:]
)
POINTS = (*ABLATIONS, *SMALL_BASELINES)


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("command", choices=COMMANDS)
    parser.add_argument("--data", action="append", required=True, help="KIND:ROOT[?OPTION=VALUE&...]; repeatable")
    parser.add_argument("--runs", type=Path, default=Path("runs/paper"), help="weights and measurements")
    parser.add_argument("--out", type=Path, default=Path("docs/paper"), help="folder of tables and figures")
    parser.add_argument(
        "--only", action="append", help=f"points to train; patterns of {', '.join(p.name for p in POINTS)}"
    )
    parser.add_argument("--pretraining", default="render:4000", help="data to begin on; empty: none")
    parser.add_argument("--steps", type=int, default=PRETRAINING.steps, help="of pretraining")
    parser.add_argument("--fine-tuning-steps", type=int, default=FINE_TUNING.steps)
    parser.add_argument("--batch-size", type=int, default=PRETRAINING.batch_size)
    parser.add_argument("--crop-size", type=int, nargs=2, default=PRETRAINING.crop_size)
    parser.add_argument("--splits", type=int, default=SPLITS, help="of each data set, to train and measure on")
    parser.add_argument("--device", default="cpu", help="where errors are computed; times are the CPU's")
    parser.add_argument("--rounds", type=int, default=7, help="turns of each method in which its time is measured")
    parser.add_argument("--weights", action="append", default=[], help="fig6: other weights beside them; repeatable")
    parser.add_argument("--full-size", action="store_true", help="fig6: time the baselines at full size, minutes each")
    parser.add_argument("--again", action="store_true", help="measure what has been measured before")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    cv2.setNumThreads(arguments.threads)
    work = Work(**{name: value for name, value in vars(arguments).items() if name != "command"})
    {"train": train_all, "table2": table2, "fig5": fig5, "fig6": fig6, "fig7": fig7}[arguments.command](work)


@dataclass
class Work:
    """The options, the data, and what has been measured."""

    threads: int
    data: list[str]
    runs: Path
    out: Path
    only: list[str] | None
    pretraining: str
    steps: int
    fine_tuning_steps: int
    batch_size: int
    crop_size: Sequence[int]
    splits: int
    device: str
    rounds: int
    weights: list[str]
    full_size: bool
    again: bool
    progress: Console = field(default_factory=lambda: Console(stderr=True))

    def __post_init__(self) -> None:
        if len({kind_of(spec) for spec in self.data}) < len(self.data):  # runs and measurements go by it
            raise SystemExit(f"--data: expected one data set of a kind, got {', '.join(self.data)}")
        if len(set(map(weights_name, self.weights))) < len(self.weights):
            raise SystemExit(f"--weights: expected files of different names, got {', '.join(self.weights)}")
        self.datasets = {spec: open_dataset(spec) for spec in self.data}

    def split(self, spec: str, number: int) -> tuple[Dataset, Dataset]:
        """Training and validation pairs of a data set's split."""
        samples = self.datasets[spec]
        chosen = draw_splits(len(samples), self.splits)[number]
        parts = ([i for i in range(len(samples)) if i not in chosen], chosen)
        train_part, validation = (Concatenation(samples.name, [(samples, i) for i in part]) for part in parts)
        return train_part, validation

    def folder(self, point: Point, spec: str, number: int) -> Path:
        """The fine-tuning run of a split."""
        return self.runs / point.name / f"{kind_of(spec)}-split{number}"

    def trained(self, point: Point, spec: str) -> list[int]:
        """Numbers of the splits whose weights are there."""
        return [i for i in range(self.splits) if (self.folder(point, spec, i) / WEIGHTS).exists()]


def kind_of(spec: str) -> str:
    return spec.partition(":")[0]


def weights_name(weights: str) -> str:
    """The file's name; of a run's, the folder's."""
    path = Path(weights)
    return path.resolve().parent.name if path.name == WEIGHTS else path.stem


# Training


def train_all(work: Work) -> None:
    """Trains each point on each split; those that are done are left as they are."""
    chosen = [p for p in POINTS if work.only is None or any(fnmatch(p.name, pattern) for pattern in work.only)]
    for point in chosen:
        begun = _pretrained(work, point) if work.pretraining else None
        for spec in work.data:
            for number in range(work.splits):
                out = work.folder(point, spec, number)
                if (out / WEIGHTS).exists():
                    continue
                work.progress.print(f"{point.name}: {spec}, split {number}")
                pairs, _ = work.split(spec, number)
                start = (
                    {"model": point.recipe.model, "input_scale": point.recipe.input_scale}
                    if begun is None
                    else {"weights": str(begun)}
                )
                recipe = replace(FINE_TUNING, network=point.recipe.network, steps=work.fine_tuning_steps, **start)
                train(_sized(work, recipe), out, resume=True, data=pairs, validation={})
    print_training(work)


def _pretrained(work: Work, point: Point) -> Path:
    out = work.runs / point.name / "pretraining"
    if not (out / WEIGHTS).exists():
        work.progress.print(f"{point.name}: {work.pretraining}")
        own = {name: getattr(point.recipe, name) for name in ("network", "model", "input_scale")}
        recipe = replace(PRETRAINING, data=(work.pretraining,), steps=work.steps, **own)
        train(_sized(work, recipe), out, resume=True)
    return out / WEIGHTS


def _sized(work: Work, recipe: Recipe) -> Recipe:
    height, width = work.crop_size
    return replace(recipe, batch_size=work.batch_size, crop_size=(height, width), threads=work.threads)


def training_of(work: Work, point: Point) -> list[str]:
    """What each run of a point took: name, steps, pairs seen, minutes."""
    lines = []
    for log in sorted((work.runs / point.name).glob(f"*/{LOG}")):
        entries = [json.loads(line) for line in log.read_text().splitlines()]
        steps = [entry for entry in entries if "losses" in entry]
        seconds, before = 0.0, 0
        for entry in steps:
            seconds += entry["seconds"] * (entry["step"] - before)
            before = entry["step"]
        batch = json.loads((log.parent / "recipe.json").read_text())["batch_size"]
        lines.append(f"| {point.name} | {log.parent.name} | {before} | {before * batch} | {seconds / 60:.1f} |")
    return lines


def print_training(work: Work) -> None:
    print(training_table(work, POINTS), end="")


def training_table(work: Work, points: Iterable[Point]) -> str:
    lines = [line for point in points for line in training_of(work, point)]
    head = ["| network | run | steps | pairs | minutes |", "| --- | --- | ---: | ---: | ---: |"]
    return "\n".join([*head, *lines]) + "\n" if lines else "No network has been trained.\n"


# Measuring


@dataclass(frozen=True)
class Errors:
    """D1 of each stage in %: mean over the splits, and standard deviation."""

    mean: tuple[float, ...]
    deviation: tuple[float, ...]
    splits: int


def _remembered(work: Work, name: str, about: list[str], measure: Callable[[], Any]) -> Any:
    """What `measure` gives, or gave before of the same data and weights, which `about` tells."""
    path = work.runs / "measured" / f"{name}.json"
    if path.exists() and not work.again:
        stored = json.loads(path.read_text())
        if isinstance(stored, dict) and stored.get("about") == about:
            return stored["found"]
    path.parent.mkdir(parents=True, exist_ok=True)
    found = measure()
    write_atomically(path, json.dumps({"about": about, "found": found}, indent=2).encode())
    return found


def errors_of(
    work: Work, name: str, spec: str, methods: dict[int, Callable[[], Method]], weights: Sequence[str] = ()
) -> Errors | None:
    """The error of a method on the pairs of each split, or None if there is no method.

    Args:
        methods: what gives the method, by number of the split; asked only where its error is not known yet.
        weights: those of the method, where the name does not tell them.
    """
    if not methods:
        return None
    by_split = []
    for number, method in methods.items():
        _, pairs = work.split(spec, number)

        def measure(method: Callable[[], Method] = method, pairs: Sequence[StereoSample] = pairs) -> list[float]:
            work.progress.print(f"{name}: {spec}")
            return [stage.mean.d1 for stage in evaluate(method(), pairs).stages]

        by_split.append(_remembered(work, f"{kind_of(spec)}-{name}-split{number}", [spec, *_digests(weights)], measure))
    stages = list(zip(*by_split, strict=True))
    deviations = tuple(statistics.stdev(stage) if len(stage) > 1 else 0.0 for stage in stages)
    return Errors(tuple(statistics.fmean(stage) for stage in stages), deviations, len(by_split))


def errors_of_point(work: Work, point: Point, spec: str) -> Errors | None:
    def method(number: int) -> Method:
        return open_method(work.folder(point, spec, number) / WEIGHTS, device=work.device, threads=work.threads)

    return errors_of(work, point.name, spec, {n: partial(method, n) for n in work.trained(point, spec)})


def everywhere(work: Work, method: Method) -> dict[int, Callable[[], Method]]:
    """A method that learns nothing of the data, for every split."""
    return dict.fromkeys(range(work.splits), lambda: method)


def _digests(weights: Iterable[str]) -> list[str]:
    return [hashlib.sha256(find_weights(one).read_bytes()).hexdigest() for one in weights]


def times_of(
    work: Work, spec: str, name: str, methods: dict[str, Method], sample: StereoSample, weights: Sequence[str] = ()
) -> dict[str, list[float]]:
    """Median milliseconds to each stage, of all methods in turns; those that take seconds have fewer turns."""

    def measure() -> dict[str, list[float]]:
        turns: dict[str, list[list[float]]] = {method: [] for method in methods}
        for turn in range(work.rounds + 1):
            for method, run in methods.items():
                slow = bool(turns[method]) and turns[method][-1][-1] > 2_000
                if slow and turn > 1:
                    continue
                work.progress.print(f"turn {turn}: {method}")
                turns[method].append([estimate.elapsed_ms for estimate in run(sample.left, sample.right)])
        # The first turn pays for the memory.
        return {m: [statistics.median(s) for s in zip(*(t[1:] or t), strict=True)] for m, t in turns.items()}

    times: dict[str, list[float]] = _remembered(
        work, f"{kind_of(spec)}-{name}-times", [spec, *methods, *_digests(weights)], measure
    )
    return times


def random_weights(work: Work, point: Point) -> Method:
    """For times, which do not depend on the weights."""
    if point.baseline is not None:
        random = random_baseline(point.baseline, point.recipe.input_scale)
        return BaselinePredictor(random, threads=work.threads).stages
    path = work.runs / point.name / "random.safetensors"
    path.parent.mkdir(parents=True, exist_ok=True)
    save_checkpoint(path, AnyNet(point.recipe.network))
    return open_method(path, threads=work.threads)


def at_scale(method: Method, scale: float) -> Method:
    """A matcher on images resized by a factor, its result enlarged, in the images' own pixels."""

    def run(left: Image, right: Image) -> Iterable[Estimate]:
        start = perf_counter()
        height, width = left.shape[:2]
        size = max(1, round(scale * width)), max(1, round(scale * height))
        small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8) for image in (left, right)]
        for estimate in method(*small):
            disparity = (cv2.resize(estimate.disparity, (width, height)) * (width / size[0])).astype(np.float32)
            yield Estimate(estimate.stage, disparity, 1e3 * (perf_counter() - start))

    return method if scale == 1 else run


# Output


def machine(work: Work) -> str:
    info = Path("/proc/cpuinfo")  # of Linux
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.machine()}, {work.threads} thread(s), torch {torch.__version__}"


def write(work: Work, name: str, figure: Any, results: dict[str, Any], text: str) -> None:
    """OUT/NAME.png, .json and .md; prints the last."""
    work.out.mkdir(parents=True, exist_ok=True)
    if isinstance(figure, np.ndarray):
        write_image(work.out / f"{name}.png", figure)
    else:
        figure.savefig(work.out / f"{name}.png", dpi=120)
    write_json(work.out / f"{name}.json", {"machine": machine(work), **results})
    write_atomically(work.out / f"{name}.md", text.encode())
    console().print(text, markup=False, highlight=False)


def _name(spec: str) -> str:
    return {"kitti2012": "KITTI 2012", "kitti2015": "KITTI 2015"}.get(kind_of(spec), kind_of(spec))


def _finished(axis: Axes, title: str) -> None:
    axis.set_title(title)
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel("milliseconds")
    axis.set_ylabel("D1, %")
    axis.grid(alpha=0.3)
    axis.legend(fontsize="x-small")


# The table and the figures


def table2(work: Work) -> None:
    """Three-pixel error of each stage, mean and deviation over splits, beside the paper's; and times."""
    results: dict[str, Any] = {}
    figure, axes = subplots(ncols=len(work.data), figsize=(5 * len(work.data), 3.5), squeeze=False)
    lines = [
        "| data | stage | D1 % here | pairs, splits | D1 % in the paper | ms here | ms on the TX2, paper |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for axis, (spec, samples) in zip(axes[0], work.datasets.items(), strict=True):
        errors = errors_of_point(work, ANYNET, spec)
        times = times_of(work, spec, "table2", {ANYNET.name: random_weights(work, ANYNET)}, samples[0])
        milliseconds, paper = times[ANYNET.name], TABLE2.get(kind_of(spec))
        for i, ms in enumerate(milliseconds):
            here = "not trained" if errors is None else f"{errors.mean[i]:.1f} ± {errors.deviation[i]:.1f}"
            count = "" if errors is None else f"{len(samples)}, {errors.splits}"
            there = "" if paper is None else f"{paper.mean[i]:.1f} ± {paper.deviation[i]:.1f}"
            lines.append(f"| {_name(spec)} | {i + 1} | {here} | {count} | {there} | {ms:.1f} | {TABLE2_TX2[i]:.1f} |")
        stages = range(1, len(milliseconds) + 1)
        if errors is not None:
            axis.errorbar(stages, errors.mean, errors.deviation, fmt="o-", capsize=3, label="here")
        if paper is not None:
            axis.errorbar(stages, paper.mean, paper.deviation, fmt="s--", capsize=3, label="paper")
        axis.set(title=_name(spec), xlabel="stage", ylabel="D1, %", xticks=list(stages))
        if errors is not None or paper is not None:
            axis.legend()
        results[spec] = {"errors": errors and asdict(errors), "milliseconds": milliseconds}
    text = "\n".join(lines) + f"\n\n{machine(work)}.\n\n{training_table(work, [ANYNET])}"
    write(work, "table2", figure, results, text)


def fig5(work: Work) -> None:
    """Disparity maps of each stage, and their errors, for a pair that the network was not trained on."""
    spec = work.data[0]
    numbers = work.trained(ANYNET, spec)
    if not numbers:
        raise SystemExit(f"fig5: expected trained weights of {ANYNET.name} in {work.runs}, got none: run train first")
    method = open_method(work.folder(ANYNET, spec, numbers[0]) / WEIGHTS, threads=work.threads)
    _, pairs = work.split(spec, numbers[0])
    sample = pairs[0]
    stages = evaluate(method, [sample]).stages
    lines = ["![Stages and errors](fig5.png)", "", "| stage | D1 % | EPE px |", "| ---: | ---: | ---: |"]
    lines += [f"| {stage.stage} | {stage.mean.d1:.1f} | {stage.mean.epe:.2f} |" for stage in stages]
    lines += ["", f"{_name(spec)}, {sample.name}."]
    results = {"pair": sample.name, "d1": [s.mean.d1 for s in stages], "epe": [s.mean.epe for s in stages]}
    write(work, "fig5", report.figure(method, sample), results, "\n".join(lines) + "\n")


@dataclass(frozen=True)
class Measured:
    """A line of a figure: points in order of time."""

    label: str
    names: tuple[str, ...]
    milliseconds: tuple[float, ...]
    errors: tuple[float, ...]
    deviations: tuple[float, ...]
    stages: bool
    """One run's stages; otherwise runs of their own, one after another in the anytime setting."""

    def curve(self) -> Curve:
        if self.stages:
            return Curve(self.milliseconds, self.errors)
        finished = one_after_another(zip(self.errors, self.milliseconds, strict=True))
        return Curve(tuple(time for _, time in finished), tuple(error for error, _ in finished))


def fig6(work: Work) -> None:
    """Error against time, and the error that the anytime setting gives at each time (Fig. 6 a to d)."""
    figure, axes = subplots(
        nrows=2, ncols=len(work.data), figsize=(6.5 * len(work.data), 9), squeeze=False, sharex=True, sharey=True
    )
    results: dict[str, Any] = {}
    lines = [
        "| data | method | ms | D1 % |",
        "| --- | --- | ---: | ---: |",
    ]
    anytime = [
        f"| data | method | mean D1 %, {FIRST_MS:g} to {LAST_MS:g} ms, log time | wasted ms |",
        "| --- | --- | ---: | ---: |",
    ]
    for column, (spec, samples) in enumerate(work.datasets.items()):
        measured, crosses = _fig6_lines(work, spec, samples[0])
        for entry in measured:
            axes[0][column].errorbar(
                entry.milliseconds, entry.errors, entry.deviations, fmt="o-" if entry.stages else "s:", capsize=2,
                label=entry.label,
            )  # fmt: skip
            anytime.append(_anytime_row(axes[1][column], spec, entry.label, entry.curve()))
            for name, ms, error in zip(entry.names, entry.milliseconds, entry.errors, strict=True):
                lines.append(f"| {_name(spec)} | {name} | {ms:.1f} | {error:.1f} |")
        own = {entry.label: entry.curve() for entry in measured if entry.label.startswith(WEIGHTS_OF)}
        if len(own) > 1:
            best = best_cascade(own)
            cut = [Curve(own[n].milliseconds[:stages], own[n].errors[:stages]) for n, stages in best]
            label = "best cascade: " + ", then ".join(
                f"{name.removeprefix(WEIGHTS_OF)} to stage {stages}" for name, stages in best
            )
            anytime.append(_anytime_row(axes[1][column], spec, label, cascade(cut)))
        for model, ms in crosses.items():
            published = ERRORS.get(model) if kind_of(spec) == "kitti2015" else None
            if published is not None:
                axes[0][column].plot(ms, published.value, "x", label=f"{model} at full size, published")
            quoted = "" if published is None else f"{published.value} (published: {published.source})"
            lines.append(f"| {_name(spec)} | {model} at full size, random weights | {ms:.0f} | {quoted} |")
        _finished(axes[0][column], f"{_name(spec)}: error and time")
        _finished(axes[1][column], f"{_name(spec)}: anytime setting")
        results[spec] = {"lines": [asdict(entry) for entry in measured], "full_size_ms": crosses}
    quoted = "\n".join(f"* {model}: {entry.value:g} ms, {entry.source}" for model, entry in TX2.items())
    parts = [
        "![Error against time](fig6.png)", "\n".join(lines), "\n".join(anytime),
        f"{machine(work)}. On a Jetson TX2, as published:\n\n{quoted}", training_table(work, POINTS),
    ]  # fmt: skip
    write(work, "fig6", figure, results, "\n\n".join(parts))


WEIGHTS_OF = "weights "


def _anytime_row(axis: Axes, spec: str, label: str, curve: Curve) -> str:
    """Draws the curve; gives its row of the table."""
    end = max(LAST_MS, curve.milliseconds[-1])
    axis.step((*curve.milliseconds, end), (*curve.errors, curve.errors[-1]), where="post", label=label)
    return f"| {_name(spec)} | {label} | {curve.area():.1f} | {curve.wasted(random_queries(1_000)):.1f} |"


def _fig6_lines(work: Work, spec: str, sample: StereoSample) -> tuple[list[Measured], dict[str, float]]:
    """What there is to draw: methods with errors, and the times of baselines at full size."""
    errors: dict[str, Errors] = {}
    methods: dict[str, Method] = {}
    labels: list[tuple[str, tuple[str, ...], bool]] = []  # label, names, stages
    for point in (ANYNET, *SMALL_BASELINES):
        found = errors_of_point(work, point, spec)
        if found is not None:
            errors[point.name], methods[point.name] = found, random_weights(work, point)
    labels.append((ANYNET.label, (ANYNET.name,), True))
    labels += [(m, tuple(p.name for p in SMALL_BASELINES if p.baseline == m), False) for m in MODELS]
    for label, matcher in (("OpenCV BM", opencv.bm), ("OpenCV SGBM", opencv.sgbm)):
        own = []
        for scale in SCALES[:2]:  # blocks of 15 pixels see nothing in smaller images
            name = label if scale == 1 else f"{label} at 1/{round(1 / scale)}"
            method = at_scale(matcher, scale)
            found = errors_of(work, name.replace("/", "-"), spec, everywhere(work, method))
            assert found is not None
            errors[name], methods[name] = found, method
            own.append(name)
        labels.append((label, tuple(own), False))
    for weights in work.weights:
        name = f"{WEIGHTS_OF}{weights_name(weights)}"
        method = open_method(weights, threads=work.threads)
        found = errors_of(work, name, spec, everywhere(work, method), [weights])
        assert found is not None
        errors[name], methods[name] = found, method
        labels.append((name, (name,), True))
    full = {f"{m}-full": Point(f"{m}-full", m, Recipe(model=m), m) for m in MODELS} if work.full_size else {}
    methods |= {name: random_weights(work, point) for name, point in full.items()}
    suffix = "-".join([str(len(methods)), *map(weights_name, work.weights)])
    times = times_of(work, spec, f"fig6-{suffix}", methods, sample, work.weights)
    measured = []
    for label, names, stages in labels:
        present = [name for name in names if name in errors]
        if not present:
            continue
        if stages:
            found = errors[present[0]]
            stage_names = tuple(f"{label}, stage {i + 1}" for i in range(len(found.mean)))
            measured.append(Measured(label, stage_names, tuple(times[present[0]]), found.mean, found.deviation, True))
            continue
        present.sort(key=lambda name: times[name][-1])
        measured.append(
            Measured(
                label,
                tuple(present),
                tuple(times[name][-1] for name in present),
                tuple(errors[name].mean[-1] for name in present),
                tuple(errors[name].deviation[-1] for name in present),
                False,
            )
        )
    return measured, {name.removesuffix("-full"): times[name][-1] for name in full}


def fig7(work: Work) -> None:
    """AnyNet, and what it is without each of its parts (Fig. 7)."""
    figure, axes = subplots(ncols=len(work.data), figsize=(6 * len(work.data), 4.5), squeeze=False)
    results: dict[str, Any] = {}
    lines = ["| data | network | stage | ms | D1 % |", "| --- | --- | ---: | ---: | ---: |"]
    for axis, (spec, samples) in zip(axes[0], work.datasets.items(), strict=True):
        methods = {point.name: random_weights(work, point) for point in ABLATIONS}
        times = times_of(work, spec, "fig7", methods, samples[0])
        results[spec] = {"milliseconds": times, "errors": {}}
        for point in ABLATIONS:
            errors = errors_of_point(work, point, spec)
            if errors is not None:
                axis.errorbar(times[point.name], errors.mean, errors.deviation, fmt="o-", capsize=2, label=point.label)
                results[spec]["errors"][point.name] = asdict(errors)
            for i, ms in enumerate(times[point.name]):
                error = "not trained" if errors is None else f"{errors.mean[i]:.1f} ± {errors.deviation[i]:.1f}"
                lines.append(f"| {_name(spec)} | {point.label} | {i + 1} | {ms:.1f} | {error} |")
        if axis.has_data():
            _finished(axis, _name(spec))
    parts = ["![Ablations](fig7.png)", "\n".join(lines), f"{machine(work)}.", training_table(work, ABLATIONS)]
    write(work, "fig7", figure, results, "\n\n".join(parts))


if __name__ == "__main__":
    main()
