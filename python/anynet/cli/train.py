"""`anynet train` and `anynet finetune`: their options are the fields of `Recipe`."""

from __future__ import annotations

import inspect
import json
import os
import shlex
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from anynet.cli.told import tell
from anynet.errors import AnyNetError
from anynet.model import presets
from anynet.model.config import AnyNetConfig
from anynet.training.recipe import PRESETS, Recipe, preset

# What the command line cannot parse is given piece by piece.
_KINDS: dict[Any, Any] = {tuple[str, ...]: list[str], tuple[float, ...]: list[float], AnyNetConfig: list[str]}

# Options that do nothing but in some runs, and in which.
_BELONGING: dict[str, tuple[str, Callable[[Recipe], bool]]] = {
    "milestone": ("--schedule step", lambda recipe: recipe.schedule == "step"),
    "validate_every": ("--validation", lambda recipe: bool(recipe.validation)),
    "network": (
        "AnyNet from random weights, or to --load-partial",
        lambda recipe: recipe.load_partial or (recipe.weights is None and recipe.model is None),
    ),
}


def _command(name: str, default: str, summary: str) -> Callable[..., None]:
    """A command with one option for each field of `Recipe`; those not given are the preset's."""

    def command(out: Path, start: str | None, resume: bool, **given: Any) -> None:
        from anynet.training.loop import train
        from anynet.training.run_folder import RECIPE

        options = {option: value for option, value in given.items() if value is not None and value != []}
        if "network" in options:
            options["network"] = _network(options["network"])
        options = {option: tuple(v) if isinstance(v, list) else v for option, v in options.items()}
        if resume and os.path.exists(out / RECIPE):
            stored = Recipe.load(out / RECIPE)
            if start is not None:  # the command that began the run, once more
                stored.check_resumed(preset(start, **options))
            recipe = replace(stored, **options)
        else:
            recipe = preset(start or default, **options)
            if resume and not recipe.data:
                raise AnyNetError(f"{out}: expected a run to resume ({RECIPE}), or --data to begin one, got neither")
            if name == "finetune" and recipe.weights is None:
                raise AnyNetError("finetune: expected weights to begin with (--weights), got none; without: train")
        for option, (other, used) in _BELONGING.items():
            if option in options and not used(recipe):
                raise AnyNetError(f"--{option.replace('_', '-')} belongs to {other}")
        try:
            print(train(recipe, out, resume=resume))
        except KeyboardInterrupt:
            if (out / RECIPE).exists() and os.environ.get("RANK", "0") == "0":
                resuming = f"anynet {name} --out {shlex.quote(str(out))} --resume"
                tell(f"interrupted; to go on: {resuming}")
            raise

    types = get_type_hints(Recipe)
    parameters = [
        _parameter("out", Path, typer.Option(help="Folder of the run: weights, checkpoint, log."), ...),
        _parameter(
            "start",
            str | None,
            typer.Option("--preset", help=f"Where to begin: {', '.join(PRESETS)}.", show_default=default),
            None,
        ),
        _parameter("resume", bool, typer.Option("--resume", help="Go on where the run in --out stopped."), False),
    ]
    for option in fields(Recipe):
        kind = _KINDS.get(types[option.name], types[option.name])
        value = getattr(PRESETS[default], option.name)
        shown = " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
        hidden = value in (None, ()) or isinstance(value, AnyNetConfig)
        info = typer.Option(help=option.metadata["help"], show_default=False if hidden else shown)
        parameters.append(_parameter(option.name, kind | None, info, None))
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__name__, command.__doc__ = name, summary
    return command


def _parameter(name: str, kind: Any, option: Any, default: Any) -> inspect.Parameter:
    annotation = Annotated[kind, option]
    default = inspect.Parameter.empty if default is ... else default
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _network(options: list[str]) -> AnyNetConfig:
    """From names of presets (the paper's, if none) and NAME=VALUE, the value in JSON."""
    config, values = presets.paper(), {}
    for option in options:
        name, equals, value = option.partition("=")
        if not equals and name in presets.NETWORKS:
            config = presets.NETWORKS[name]()
            continue
        try:
            values[name] = json.loads(value)
        except (ValueError, RecursionError):  # also of numbers too long for Python
            raise AnyNetError(
                f"--network: expected one of {', '.join(presets.NETWORKS)}, or NAME=VALUE with the value in JSON like "
                f"features.channels=2, got {option!r}"
            ) from None
    return config.with_options(values)


train = _command("train", "default", "Train a network from scratch.")
finetune = _command("finetune", "kitti", "Train weights further on other data.")
