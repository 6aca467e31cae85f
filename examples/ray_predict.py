"""Disparity of very many pairs on a Ray cluster (pip install 'anynet[ray]').

    python examples/ray_predict.py LEFT RIGHT --out DIR --actors 8
    python examples/ray_predict.py --list pairs.csv --out DIR --format parquet

LEFT and RIGHT are folders or quoted patterns as of `anynet predict`; a list has columns left and right, paths relative
to it. Each actor has a predictor of its own. Files are NAME.pfm; a Parquet file holds the pairs of one batch: name,
stage, height, width and disparity, float32 row by row. A file is written whole or not at all. What is there already is
not computed again, so the same call goes on after an interruption; the work of a worker that dies is done again by
another one. Pairs that cannot be read are reported, and the exit status is then 2.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import io
import sys
from pathlib import Path
from typing import Any

import numpy as np

from anynet import AnyNetError, Estimate, Predictor
from anynet.cli.pairs import find_pairs
from anynet.io import read_pair, write_disparity
from anynet.io.files import make_folder, read_text, telling_damage, write_atomically


class Actor:
    """Computes and writes batches of pairs: columns name, left and right in, name and error ("" for none) out."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.predictor = Predictor(options.weights, threads=options.threads)

    def __call__(self, batch: dict[str, np.ndarray]) -> dict[str, list[str]]:
        rows, errors = [], []
        for name, left, right in zip(batch["name"], batch["left"], batch["right"], strict=True):
            try:
                estimate = self.predictor.predict(*read_pair(left, right), stage=self.options.stage)
                if self.options.format == "files":
                    write_disparity(self.options.out / f"{name}.pfm", estimate.disparity)
                else:
                    rows.append(row_of(name, estimate))
                errors.append("")
            except AnyNetError as error:
                errors.append(str(error))
        if rows:
            write_parquet(self.options.out, rows)
        return {"name": list(batch["name"]), "error": errors}


def row_of(name: str, estimate: Estimate) -> dict[str, Any]:
    height, width = estimate.disparity.shape
    content = estimate.disparity.tobytes()
    return {"name": name, "stage": estimate.stage, "height": height, "width": width, "disparity": content}


def write_parquet(folder: Path, rows: list[dict[str, Any]]) -> None:
    """In a file whose name follows from the pairs: when they are done again, it takes the place of the first one."""
    import pyarrow.parquet

    content = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows), content)
    name = hashlib.sha256("\n".join(row["name"] for row in rows).encode()).hexdigest()[:16]
    write_atomically(folder / f"{name}.parquet", content.getvalue())


def listed(path: Path) -> list[dict[str, str]]:
    """The pairs of a list.

    Raises:
        AnyNetError: if the file cannot be read, or a row lacks one of the two.
    """
    with telling_damage(path, "not a CSV file"):
        rows = list(csv.DictReader(io.StringIO(read_text(path), newline="")))
    if not rows or not all(row.get("left") and row.get("right") for row in rows):
        raise AnyNetError(f"{path}: expected a CSV file with columns left and right, both in every row")
    places = [{side: str((path.parent / row[side]).absolute()) for side in ("left", "right")} for row in rows]
    # Numbered, for files of one name in different folders.
    return [{"name": f"{i:08d}_{Path(place['left']).stem}", **place} for i, place in enumerate(places)]


def done(folder: Path, format: str) -> set[str]:
    """Names of the pairs whose results are there."""
    if format == "files":
        return {file.stem for file in folder.glob("*.pfm")}
    import pyarrow.parquet

    names: set[str] = set()
    for file in folder.glob("*.parquet"):
        names |= set(pyarrow.parquet.read_table(file, columns=["name"])["name"].to_pylist())
    return names


def count(text: str) -> int:
    number = int(text)
    if number < 1:
        raise ValueError
    return number


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", nargs="*", metavar="LEFT RIGHT")
    parser.add_argument("--list", type=Path, metavar="CSV")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--format", choices=["files", "parquet"], default="files")
    parser.add_argument("--weights", default="default")
    parser.add_argument("--stage", type=count)
    parser.add_argument("--actors", type=count, default=2)
    parser.add_argument("--threads", type=count, default=1, help="of each actor")
    parser.add_argument("--batch", type=count, default=16, help="pairs that an actor gets at a time")
    options = parser.parse_args()
    if (options.list is None) != (len(options.images) == 2):
        parser.error("expected LEFT and RIGHT, or --list")
    try:
        alone: list[Path] = []
        if options.list is not None:
            pairs = listed(options.list)
        else:
            found, alone = find_pairs(*options.images)
            pairs = [{"name": p.name, "left": str(p.left.absolute()), "right": str(p.right.absolute())} for p in found]
        make_folder(options.out)
        options.out = options.out.absolute()
        present = done(options.out, options.format)
    except AnyNetError as error:
        print(f"ray_predict: {error}", file=sys.stderr)
        return 2
    waiting = [pair for pair in pairs if pair["name"] not in present]
    print(f"{len(pairs)} pairs, {len(waiting)} to do", flush=True)
    failed = len(alone)
    for path in alone:
        print(f"ray_predict: {path}: no image of this name in the other folder", file=sys.stderr)
    if waiting:
        import ray

        ray.init(include_dashboard=False)
        results = ray.data.from_items(waiting, override_num_blocks=-(-len(waiting) // options.batch)).map_batches(
            Actor,
            fn_constructor_args=(options,),
            batch_size=options.batch,
            compute=ray.data.ActorPoolStrategy(size=options.actors),
            num_cpus=options.threads,
        )
        for row in results.iter_rows():
            if row["error"]:
                failed += 1
                print(f"ray_predict: {row['name']}: {row['error']}", file=sys.stderr)
    print(f"{len(waiting) - failed + len(alone)} done, {failed} failed")
    return 2 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
