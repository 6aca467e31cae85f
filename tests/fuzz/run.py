"""Fuzzes one target, or all: python tests/fuzz/run.py TARGET --inputs 100000.

Damaged files go to the readers, random arguments to the operators (targets.py), in a process of their own. What must
not happen is counted as failed: a signal, more than 5 s of computing, more memory than --memory (of a reader; an
operator takes what its arguments ask for), an exception that is not documented, a message that is not one short line
with the file's name. Failing inputs are kept, in --keep. An input is a function of target, seed and number: --first N
--inputs 1 makes it again. Exit status 1 if anything failed.

With --engine atheris the bytes are found by coverage (pip install 'anynet[fuzz]') instead of at random.
"""

from __future__ import annotations

import argparse
import json
import math
import mmap
import os
import resource
import select
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "anynet"))  # where the recordings' writer is

from mutations import mutated
from targets import TARGETS, Calls, Reader

SECONDS = 5  # of computing, per input
MEMORY = 2 * 10**9  # bytes in use, of a reader
LETTERS = 1000  # of a message
_ADDRESSES = 6 * 10**9  # of the process, so that the machine survives what fails
_STUCK = 600  # seconds without a sign of life: it waits, without computing

FINE = ("read", "refused", "computed")


class _Input:
    """Number `number` of a target: its bytes (of a reader) in a file, and what became of it."""

    def __init__(self, name: str, seed: int, folder: Path) -> None:
        self.name, self.seed = name, seed
        self.target = TARGETS[name]
        self.seeds = self.target.corpus() if isinstance(self.target, Reader) else []
        self.file = folder / f"input{self.target.ending if isinstance(self.target, Reader) else ''}"
        if isinstance(self.target, Reader):  # what it imports, and prepares, takes seconds that are not an input's
            self.read(self.seeds[0])
        else:
            self.target.prepare()

    def run(self, number: int) -> str:
        """Makes the input and tries it: the outcome, one of FINE or what failed."""
        key = f"{self.name} {self.seed} {number}"
        if isinstance(self.target, Calls):
            return "computed" if self.target.call(key) else "refused"
        return self.read(mutated(self.seeds, key))

    def read(self, data: bytes) -> str:
        from anynet.errors import AnyNetError

        assert isinstance(self.target, Reader)
        self.file.write_bytes(data)
        try:
            self.target.call(self.file)
        except AnyNetError as error:
            causes: list[BaseException] = [error]
            while (cause := causes[-1].__cause__ or causes[-1].__context__) is not None:
                causes.append(cause)
            if any(isinstance(cause, MemoryError) for cause in causes):
                return f"memory: {error}"
            text = str(error)
            if not text.isprintable() or len(text) > LETTERS or str(self.file) not in text:
                return f"message: {text}"
            return "refused"
        return "read"


def _work(name: str, seed: int, first: int, last: int, memory: int, folder: Path) -> None:
    """The worker: keeps the count in _Progress, and says a line of JSON per failure, [number, outcome]."""
    warnings.simplefilter("ignore")
    source, progress = _Input(name, seed, folder), _Progress(folder)
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES, _ADDRESSES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for number in range(first, last):
        progress.begin()
        signal.setitimer(signal.ITIMER_PROF, SECONDS)  # nobody handles it, so it ends even what hangs in C
        try:
            outcome = source.run(number)
        except Exception as error:
            outcome = f"{type(error).__name__}: {error}\n{traceback.format_exc()}"
        signal.setitimer(signal.ITIMER_PROF, 0)
        used = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        if used > memory and isinstance(source.target, Reader):
            outcome = f"memory: {used / 1e9:.1f} GB"
        if outcome not in FINE:
            if source.file.exists():
                source.file.replace(folder / f"{number}{source.file.suffix}")
            os.write(3, json.dumps([number, outcome]).encode() + b"\n")
        progress.end(outcome)
        if used > memory:
            return  # the most ever used is all that the system tells: begin again


class _Progress:
    """How many inputs a worker has begun and ended, and how they ended, in memory that outlives it."""

    def __init__(self, folder: Path) -> None:
        file = folder / "progress"
        with file.open("r+b") as opened:
            self._counts = memoryview(mmap.mmap(opened.fileno(), 0)).cast("q")

    @classmethod
    def anew(cls, folder: Path) -> _Progress:
        (folder / "progress").write_bytes(bytes(8 * (2 + len(FINE))))
        return cls(folder)

    def begin(self) -> None:
        self._counts[0] += 1

    def end(self, outcome: str) -> None:
        if outcome in FINE:
            self._counts[2 + FINE.index(outcome)] += 1
        self._counts[1] += 1

    @property
    def begun(self) -> int:
        return self._counts[0]

    @property
    def ended(self) -> int:
        return self._counts[1]

    @property
    def fine(self) -> Counter[str]:
        return +Counter(dict(zip(FINE, self._counts[2:], strict=True)))


class _Worker:
    """A process that works on the inputs first ... last - 1."""

    def __init__(self, name: str, seed: int, first: int, last: int, memory: int, folder: Path) -> None:
        self.progress = _Progress.anew(folder)
        self.seconds, self.stopped = 0.0, False
        self._failures, writing = os.pipe()
        own = [sys.executable, __file__, name, "--seed", str(seed), "--memory", str(memory)]
        own += ["--worker", str(first), str(last), str(folder)]
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONFAULTHANDLER": "", "TMPDIR": str(folder)}
        self.process = subprocess.Popen(
            ["bash", "-c", 'exec 3>&"$0"; exec "$@"', str(writing), *own],
            pass_fds=[writing],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        os.close(writing)

    def failures(self, seconds: float) -> Iterator[tuple[int, str]]:
        """Those that it tells, until it has ended: in time, after so many seconds of trying, or if it only waits."""
        buffer, begun, changed = b"", 0, time.monotonic()
        start: float | None = None
        while True:
            now = time.monotonic()
            if self.progress.begun != begun:
                begun, changed = self.progress.begun, now
            if start is None and begun:
                start = now
            self.seconds = now - (start or now)  # not those of starting
            self.stopped = self.seconds >= seconds
            if self.stopped or now - changed > _STUCK:
                self.process.kill()
            if not select.select([self._failures], [], [], 0.2)[0]:
                continue
            data = os.read(self._failures, 2**20)
            if not data:
                os.close(self._failures)
                self.process.wait()
                return
            *lines, buffer = (buffer + data).split(b"\n")
            for line in lines:
                number, outcome = json.loads(line)
                yield number, outcome


def fuzz(
    name: str, seed: int, inputs: int, *, first: int = 0, seconds: float = math.inf, memory: int = MEMORY, keep: Path
) -> Counter[str]:
    """Tries the inputs first ... first + inputs - 1, for at most that many seconds; counts the outcomes."""
    counts: Counter[str] = Counter()
    shared = Path("/dev/shm")
    next_input, last = first, first + inputs
    with tempfile.TemporaryDirectory(dir=shared if shared.is_dir() else None) as temporary:
        folder = Path(temporary)
        while next_input < last:
            worker = _Worker(name, seed, next_input, last, memory, folder)
            for number, outcome in worker.failures(seconds):
                _failed(counts, name, number, outcome, next(folder.glob(f"{number}.*"), None), keep)
            counts += worker.progress.fine
            next_input += worker.progress.ended
            seconds -= worker.seconds
            if worker.stopped:
                break
            status = worker.process.returncode
            if worker.progress.begun == worker.progress.ended:
                if status:
                    raise RuntimeError(f"{name}: the worker ended with {status} before input {next_input}")
                continue
            if status in (-signal.SIGPROF, -signal.SIGKILL):
                outcome = f"more than {SECONDS} s"
            else:
                outcome = f"signal {signal.Signals(-status).name}" if status < 0 else f"exit {status}"
            _failed(counts, name, next_input, outcome, next(folder.glob("input.*"), None), keep)
            next_input += 1
    return counts


def _failed(counts: Counter[str], name: str, number: int, outcome: str, file: Path | None, keep: Path) -> None:
    kind = f"FAILED {outcome.split(':')[0].splitlines()[0]}"
    counts[kind] += 1
    if counts[kind] <= 20:
        keep.mkdir(parents=True, exist_ok=True)
        (keep / f"{name}-{number}.txt").write_text(outcome + "\n")
        if file is not None:
            (keep / f"{name}-{number}{file.suffix}").write_bytes(file.read_bytes())


def _atheris(name: str, inputs: int, memory: int, keep: Path) -> None:
    """Never returns: libFuzzer ends the process, with status 0 if nothing failed."""
    import atheris

    included = ["anynet", "PIL", "numpy.lib"]
    with tempfile.TemporaryDirectory() as temporary, atheris.instrument_imports(include=included):
        source = _Input(name, 0, Path(temporary))
        assert isinstance(source.target, Reader), f"{name} does not read files"

        def one(data: bytes) -> None:
            outcome = source.read(data)
            if outcome not in FINE:
                raise RuntimeError(outcome)

        seeds = Path(temporary) / "corpus"
        seeds.mkdir()
        for number, data in enumerate(source.seeds):
            (seeds / str(number)).write_bytes(data)
        keep.mkdir(parents=True, exist_ok=True)
        limits = [f"-runs={inputs}", f"-timeout={SECONDS}", f"-rss_limit_mb={memory // 2**20}"]
        warnings.simplefilter("ignore")
        atheris.Setup([sys.argv[0], *limits, f"-artifact_prefix={keep}/{name}-", str(seeds)], one)
        atheris.Fuzz()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", choices=[*TARGETS, "all"])
    parser.add_argument("--inputs", type=int, default=10_000, help="how many, per target")
    parser.add_argument("--seconds", type=float, default=math.inf, help="at most so long, per target")
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--memory", type=int, default=MEMORY, help="bytes in use, at most")
    parser.add_argument("--engine", choices=["mutations", "atheris"], default="mutations")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-failures"), help="folder for failing inputs")
    parser.add_argument("--worker", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        first, last, folder = options.worker
        _work(options.target, options.seed, int(first), int(last), options.memory, Path(folder))
        return 0
    if options.engine == "atheris":
        _atheris(options.target, options.inputs, options.memory, options.keep)
    failed = False
    for name in TARGETS if options.target == "all" else [options.target]:
        start = time.monotonic()
        counts = fuzz(
            name,
            options.seed,
            options.inputs,
            first=options.first,
            seconds=options.seconds,
            memory=options.memory,
            keep=options.keep,
        )
        outcomes = ", ".join(f"{count} {kind}" for kind, count in sorted(counts.items(), key=lambda one: one[0]))
        print(f"{name}: {counts.total()} inputs in {time.monotonic() - start:.0f} s: {outcomes}", flush=True)
        failed |= any(kind not in FINE for kind in counts)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
