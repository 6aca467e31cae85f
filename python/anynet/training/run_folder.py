"""The folder of a training run: what lies there, and that nobody else writes to it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import filelock

from anynet.errors import AnyNetError
from anynet.io.files import make_folder, remove_unfinished
from anynet.training.recipe import Recipe

RECIPE, CHECKPOINT, LOG, WEIGHTS = "recipe.json", "checkpoint.pt", "log.jsonl", "weights.safetensors"
LOCK = "run.lock"
PATIENCE = 10  # seconds: the data workers of a run that was killed hold its lock until they notice, after 5


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """Keeps the folder from a second process, however the first one ends."""
    make_folder(out)
    try:
        held = filelock.FileLock(out / LOCK).acquire(timeout=PATIENCE)
    except filelock.Timeout:
        raise AnyNetError(f"{out}: another process is training there") from None
    except OSError as error:
        raise AnyNetError(f"cannot write {out / LOCK}: {error.strerror}") from error
    with held:
        remove_unfinished(out)  # of a run that was killed
        yield


def check_free(recipe: Recipe, out: Path, resume: bool) -> None:
    """Sees that the folder holds no run, or this recipe's that is to go on, nor weights from elsewhere."""
    begun = any(os.path.exists(out / name) for name in (RECIPE, CHECKPOINT))
    if begun and not resume:
        raise AnyNetError(f"{out} holds a run already: resume it, or choose another folder")
    if not begun and os.path.exists(out / WEIGHTS):
        raise AnyNetError(f"{out / WEIGHTS} is of no run, and would be overwritten: choose another folder")
    if os.path.exists(out / RECIPE):
        Recipe.load(out / RECIPE).check_resumed(recipe)
