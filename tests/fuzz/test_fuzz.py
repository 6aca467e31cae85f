"""A short run of every fuzzer, and a check of the harness itself. For hours: python tests/fuzz/run.py all."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from random import Random

import corpus
import operators
import pytest
import torch
from mutations import mutated
from run import FINE, fuzz
from targets import TARGETS, Reader

from anynet.errors import AnyNetError

RUN = Path(__file__).with_name("run.py")
READERS = [name for name, target in TARGETS.items() if isinstance(target, Reader)]


@pytest.mark.slow
@pytest.mark.parametrize("name", list(TARGETS))
def test_smoke(tmp_path: Path, name: str) -> None:
    """About a minute for all of them, most of it to start."""
    counts = fuzz(name, seed=1, inputs=2000, seconds=1, keep=tmp_path)
    found = [file.read_text()[:1000] for file in sorted(tmp_path.glob("*.txt"))]
    assert set(counts) <= set(FINE), found
    assert counts.total() > 0


@pytest.mark.parametrize("name", READERS)
def test_the_corpus_is_sound(tmp_path: Path, name: str) -> None:
    """Most of the files are read as they are, so that the damage is what is tried."""
    target = TARGETS[name]
    assert isinstance(target, Reader)
    outcomes = []
    for data in target.corpus():
        file = tmp_path / f"input{target.ending}"
        file.write_bytes(data)
        try:
            target.call(file)
        except AnyNetError as error:
            outcomes.append(str(error))
        else:
            outcomes.append("")
    assert "" in outcomes or name == "checkpoint-tar", outcomes  # the authors' weights are not ours to make


def test_every_operator_is_called_with_tensors_that_it_takes() -> None:
    threads = torch.get_num_threads()  # which the calls change
    accepted = Counter(
        one[0]
        for one in operators.operators()
        for number in range(40)
        if operators.accepted(*one, Random(f"{one[0]} {number}"), spoilt=(0,))
    )
    torch.set_num_threads(threads)
    assert accepted.keys() == operators.SHAPES.keys()
    assert min(accepted.values()) > 3, accepted


def test_inputs_can_be_made_again() -> None:
    seeds = corpus.png()
    first = [mutated(seeds, f"png 0 {number}") for number in range(200)]
    assert first == [mutated(seeds, f"png 0 {number}") for number in range(200)]
    assert len(set(first)) > 180
    assert sum(data in seeds for data in first) < 20  # such as those of which nothing was cut off


FAULTY = """
import os, signal, time
from pathlib import Path
import targets
from anynet.errors import AnyNetError

def faulty(file):
    if not (file.parent / f"begun{os.getpid()}").exists():
        return (file.parent / f"begun{os.getpid()}").touch()  # what is read first, before all inputs
    number = len(list(file.parent.glob("n*")))
    (file.parent / f"n{number}").touch()
    if number == 0: os.kill(os.getpid(), signal.SIGSEGV)
    if number == 1: raise KeyError("a")
    if number == 2:
        while True: pass
    if number == 3: raise AnyNetError("without the name")
    if number == 4: raise AnyNetError(f"{file}: {'long ' * 1000}")
    if number == 5: bytearray(b"x") * 10**9
    if number == 6:
        try: bytearray(10**11)
        except MemoryError as error: raise AnyNetError(f"{file}: large") from error
    if number == 7: raise AnyNetError(f"{file}: as it should")

targets.TARGETS["csv"] = targets.Reader(faulty, ".csv", targets.corpus.csv)
"""


def test_the_harness_sees_what_must_not_happen(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(f"import sys; sys.path.insert(0, {str(RUN.parent)!r})\n{FAULTY}")
    path = os.pathsep.join([str(tmp_path), *(p for p in sys.path if p)])
    command = [sys.executable, str(RUN), "csv", "--inputs", "9", "--keep", str(tmp_path / "kept")]
    command += ["--memory", str(10**9)]  # the usual 2 GB may take over 5 s to fill, on a busy machine
    result = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    assert result.returncode == 1, result.stderr
    assert result.stdout.startswith("csv: 9 inputs in ")
    outcomes = dict(reversed(part.split(" ", 1)) for part in result.stdout.strip().split(": ", 2)[2].split(", "))
    assert outcomes == {
        "FAILED signal SIGSEGV": "1",
        "FAILED KeyError": "1",
        "FAILED more than 5 s": "1",
        "FAILED message": "2",
        "FAILED memory": "2",
        "refused": "1",
        "read": "1",
    }
    assert len(list((tmp_path / "kept").glob("csv-*.csv"))) == 7
