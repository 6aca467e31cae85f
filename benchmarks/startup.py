"""How long a program takes to start, beyond `import torch`: processor time, since a clock would show other work too.

python benchmarks/startup.py [--runs 15] [--json FILE]

Programs take turns; a difference is between neighbors, and the median of all is printed. PyTorch gets one thread.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from measure import console, options, pair, write_json
from rich.table import Table

from anynet.io import write_image


def seconds(program: list[str]) -> float:
    """User and system time of a process that runs this Python with these arguments."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, *program], check=True, stdout=subprocess.DEVNULL, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = options(__doc__, threads=None)
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--json", type=Path, help="write the figures here")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        images = [f"{folder}/left.png", f"{folder}/right.png"]
        for path, image in zip(images, pair(375, 1242), strict=True):
            write_image(path, image)
        programs = {
            "import torch": ["-c", "import torch"],
            "import anynet_ext": ["-c", "import anynet_ext"],
            "anynet.Predictor()": ["-c", "import anynet; anynet.Predictor()"],
            "anynet predict LEFT RIGHT": ["-m", "anynet", "predict", *images, "--out", folder],
        }
        for program in programs.values():  # files into the cache, and Python's compiled ones
            seconds(program)
        runs = [{name: seconds(program) for name, program in programs.items()} for _ in range(arguments.runs)]
    table = Table("program", "processor time, s", "beyond import torch, s")
    report = {}
    for name in programs:
        beyond = [run[name] - run["import torch"] for run in runs]
        report[name] = {"seconds": median(run[name] for run in runs), "beyond_torch": median(beyond)}
        table.add_row(name, f"{report[name]['seconds']:.2f}", f"{report[name]['beyond_torch']:.2f}")
    console().print(table)
    write_json(arguments.json, report)


if __name__ == "__main__":
    main()
