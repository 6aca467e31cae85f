"""Draws the losses of training runs.

python benchmarks/curves.py NAME=RUN/log.jsonl ... --plot FILE
"""

from __future__ import annotations

import json
from pathlib import Path

from measure import options, subplots


def main() -> None:
    parser = options(__doc__, threads=None)
    parser.add_argument("logs", nargs="+", metavar="NAME=LOG", help="log.jsonl of a run, and what to call it")
    parser.add_argument("--plot", type=Path, required=True)
    arguments = parser.parse_args()

    count = len(arguments.logs)
    figure, axes = subplots(ncols=count, figsize=(5 * count, 3.5), squeeze=False)
    for axis, entry in zip(axes[0], arguments.logs, strict=True):
        name, _, path = entry.partition("=")
        lines = [json.loads(line) for line in Path(path).read_text().splitlines()]
        lines = [line for line in lines if "losses" in line]
        for stage, losses in enumerate(zip(*(line["losses"] for line in lines), strict=True), start=1):
            axis.semilogy([line["step"] for line in lines], losses, label=f"stage {stage}", linewidth=1)
        axis.set_title(name)
        axis.set_xlabel("step")
        axis.set_ylabel("smooth-L1 loss, px")
        axis.legend()
    figure.savefig(arguments.plot, dpi=120)


if __name__ == "__main__":
    main()
