"""Every code block of README.md and docs/*.md works as pasted.

* Blocks fenced as `python` are run, each as a script of its own, in a folder with `left.png`, `right.png`,
  `image_2/`, `image_3/`, `calib.txt`, `stereo.yaml` and, for docs/weights.md, the weights of the runs that it lists.
  Training ends after one step of one small crop.
* All other blocks, indented or fenced as `sh`, are run by bash, those of a file one after the other, with recorders in
  place of the programs. `anynet predict`, `demo`, `info` and `--help` are then run; all other recorded calls are parsed
  by the real programs, or checked for what they name.
* A block after `<!-- not run: why -->` is compiled or parsed only.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
import torch
import typer
from markdown_it import MarkdownIt

from anynet import AnyNet, cli, save_checkpoint
from anynet.camera import Camera, StereoRig
from anynet.camera.write import write_rig
from anynet.data.registry import OPENERS, open_dataset
from anynet.io import write_image
from anynet.model import presets
from anynet.training import loop
from anynet.training.recipe import Recipe

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SHELL = ("", "sh", "bash")
OTHERS = ("text", "json", "toml", "yaml", "cpp", "csv")
PROGRAMS = (
    "anynet", "cmake", "compute-sanitizer", "ctest", "mkdocs", "mypy", "pip", "pytest", "python", "ruff", "torchrun",
)  # fmt: skip
SCRIPTS = ("build/gpu/tests/cuda/cuda_check", ".ci/gpu", ".ci/wheels")  # called by their paths
CALIBRATION = "cam0=[100 0 32; 0 100 24; 0 0 1]\nbaseline=120\ndoffs=0\nwidth=64\nheight=48\n"
Call = list[str]


@dataclass(frozen=True)
class Block:
    """A block's first line in the page; its language as fenced, "" if it is not."""

    page: Path
    line: int
    language: str
    text: str
    runs: bool = True

    def __str__(self) -> str:
        return f"{self.page.name}:{self.line}"


def blocks(page: Path) -> Iterator[Block]:
    runs = True
    for token in MarkdownIt().parse(page.read_text()):
        if token.type in ("fence", "code_block"):
            assert token.map is not None
            yield Block(page, token.map[0] + 1, token.info.strip(), token.content, runs)
            runs = True
        elif token.type == "html_block":
            runs = not token.content.startswith("<!-- not run: ")


BLOCKS = [block for page in PAGES for block in blocks(page)]
PYTHON = [block for block in BLOCKS if block.language == "python"]


@pytest.fixture(autouse=True)
def _threads() -> Iterator[None]:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with what a reader would have there."""
    texture = np.random.default_rng(0).integers(0, 256, (12, 17, 3), np.uint8).repeat(4, 0).repeat(4, 1)
    left, right = texture[:, :64], texture[:, 4:]
    for name, image in {
        "left.png": left, "right.png": right, "image_2/000000.png": left, "image_3/000000.png": right,
    }.items():  # fmt: skip
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write_image(tmp_path / name, image)
    (tmp_path / "calib.txt").write_text(CALIBRATION)
    camera = Camera(np.array([[100, 0, 32], [0, 100, 24], [0, 0, 1.0]]), np.zeros(5))
    write_rig(tmp_path / "stereo.yaml", StereoRig(camera, camera, np.eye(3), np.array([-0.12, 0, 0]), (64, 48)))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def saved_runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of training runs, with random values."""
    runs = tmp_path_factory.mktemp("saved") / "runs"
    large = presets.large().with_input_scale(2)
    far = large.with_options({"refinement.directions": (1, 0), "refinement.convex_upsampling": False})
    for name, config in {"first": large, "finer": large, "far": far}.items():
        (runs / name).mkdir(parents=True)
        save_checkpoint(runs / name / "weights.safetensors", AnyNet(config))
    return runs


@pytest.fixture
def runs(folder: Path, saved_runs: Path) -> None:
    shutil.copytree(saved_runs, folder / "runs")


@pytest.fixture
def one_step(monkeypatch: pytest.MonkeyPatch) -> list[Recipe]:
    """Training runs end after one step on a pair that is rendered for them; returns their recipes."""
    recipes: list[Recipe] = []
    train = loop.train

    def short(recipe: Recipe, out: Path, **options: Any) -> Path:
        recipes.append(recipe)
        small = replace(recipe, steps=1, epochs=None, batch_size=1, crop_size=(64, 128), workers=0, threads=1)
        return train(small, out, data=open_dataset("render:1?height=96&width=160"), **options)

    monkeypatch.setattr(loop, "train", short)
    return recipes


def test_the_blocks_are_found_and_of_known_kinds() -> None:
    assert len(BLOCKS) > 15
    assert len(PYTHON) >= 5
    assert {block.language for block in BLOCKS} <= {"python", *SHELL, *OTHERS}


@pytest.mark.parametrize("block", PYTHON, ids=str)
def test_python(block: Block, folder: Path, runs: None, one_step: list[Recipe]) -> None:
    code = compile("\n" * block.line + block.text, str(block.page), "exec")
    if block.runs:
        exec(code, {"__name__": "__main__"})
    if "train(" in block.text:
        assert len(one_step) == 1


def record(blocks: Sequence[Block], folder: Path) -> list[tuple[Block, Call]]:
    """The programs that bash calls in the blocks, with their arguments."""
    stubs, calls = folder / ".stubs", folder / ".calls"
    calls.touch()
    for stub in (*(stubs / program for program in PROGRAMS), *(folder / script for script in SCRIPTS)):
        stub.parent.mkdir(parents=True, exist_ok=True)
        stub.write_text(f"#!/bin/sh\nprintf '%s\\037' {stub.name} \"$@\" >>'{calls}'; echo >>'{calls}'\n")
        stub.chmod(0o755)
    environment = {**os.environ, "PATH": f"{stubs}:{os.environ['PATH']}"}
    found: list[tuple[Block, Call]] = []
    before = ""
    for block in blocks:
        calls.write_text("")
        script = f"set -euo pipefail\n{before}\n: >{shlex.quote(str(calls))}\n{block.text}"
        result = subprocess.run(["bash", "-c", script], cwd=folder, env=environment, capture_output=True, text=True)
        assert (result.returncode, result.stderr) == (0, ""), f"{block}: {result.stderr}"
        found += [(block, line.split("\037")[:-1]) for line in calls.read_text().splitlines()]
        before += block.text  # its variables hold in later blocks
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_shell(
    page: Path,
    folder: Path,
    one_step: list[Recipe],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shell = [block for block in BLOCKS if block.page == page and block.language in SHELL]
    if not shell:
        pytest.skip(f"{page.name} has no shell blocks")
    calls = record(shell, folder)
    assert {id(block) for block, _ in calls} == {id(block) for block in shell}, "a block calls no program"
    for block, call in calls:
        try:
            check(call, block.runs, monkeypatch)
        except (Exception, SystemExit) as error:
            pytest.fail(f"{block}: {shlex.join(call)}: {error!r}; {capsys.readouterr().err}")


def check(call: Call, runs: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Raises if the program would not take these arguments."""
    program, *arguments = call
    if program == "torchrun":
        program, *arguments = arguments[arguments.index("-m") + 1 :]
    if (
        program == "anynet"
        and runs
        and arguments[0] in ("predict", "demo", "info", "--help")
        and "--view" not in arguments
    ):
        assert cli.main(arguments) == 0
    elif program == "anynet":
        parse_anynet(arguments)
    elif program == "python" and arguments[0] == "-c":
        imports = [node for node in ast.parse(arguments[1]).body if isinstance(node, (ast.Import, ast.ImportFrom))]
        exec(compile(ast.Module(imports, []), "-c", "exec"), {})
    elif program == "python":
        parse_script(ROOT / arguments[0], arguments[1:], monkeypatch)
    elif program == "pip":
        extras = re.findall(r"\[([\w,]+)\]", " ".join(arguments))
        for extra in ",".join(extras).split(",") if extras else []:
            assert re.search(rf"^{extra} = \[", (ROOT / "pyproject.toml").read_text(), re.MULTILINE), extra
    elif program == "pytest":
        parsed = argparse.ArgumentParser()
        parsed.add_argument("-m")
        parsed.add_argument("-k")
        parsed.add_argument("-q", action="store_true")
        parsed.add_argument("paths", nargs="*")
        for path in parsed.parse_args(arguments).paths:
            assert (ROOT / path).exists(), path
    elif program == "cmake":
        for option in re.findall(r"-D(ANYNET_\w+)=", " ".join(arguments)):
            assert option in (ROOT / "CMakeLists.txt").read_text(), option


def parse_anynet(arguments: Call) -> None:
    """Parses them; training also makes its recipe, and data sets must be of a known kind."""
    name = arguments[0]
    assert name in cli.COMMANDS, name
    given: list[dict[str, Any]] = []
    group: Any = typer.main.get_command(cli._application(name))
    command = group.commands[name]
    act: Callable[..., Any] = command.callback
    command.callback = lambda **options: given.append(options)
    if "--help" in arguments:
        return
    group.main(arguments, prog_name="anynet", standalone_mode=False)
    (options,) = given
    for spec in options.get("data") or []:
        assert spec.partition(":")[0] in OPENERS, spec
    if name in ("train", "finetune"):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(loop, "train", lambda recipe, out, resume: out)
            act(**options)


def parse_script(script: Path, arguments: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs a script up to the parsing of its options."""
    parse = argparse.ArgumentParser.parse_args

    class Parsed(Exception):
        pass

    def stop(parser: argparse.ArgumentParser) -> NoReturn:
        parse(parser)
        raise Parsed

    with monkeypatch.context() as patch:
        patch.setattr(argparse.ArgumentParser, "parse_args", stop)
        patch.setattr(sys, "argv", [str(script), *arguments])
        patch.syspath_prepend(str(script.parent))
        with pytest.raises(Parsed):
            runpy.run_path(str(script), run_name="__main__")


INLINE = [
    (page, text) for page in PAGES for text in re.findall(r"`((?:python benchmarks/|pytest )[^`]+)`", page.read_text())
]


@pytest.mark.parametrize(("page", "text"), INLINE, ids=[f"{page.name}: {text}" for page, text in INLINE])
def test_commands_in_the_text(page: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    check(shlex.split(text), False, monkeypatch)


@pytest.mark.parametrize(
    "command",
    [
        "anynet predict left.png right.png --scale 2",
        "anynet train --data moon:pairs --out runs/new",
        "anynet train --data rendered:pairs --out runs/new --rate 1e-3",
        "anynet finetune --data rendered:pairs --out runs/new --warmup-steps -1 --crop-size 1 1",
        "anynet dream",
        "python benchmarks/kernels.py --thread-count 2",
        "python benchmarks/nothing.py",
        "python -c 'from anynet import nothing'",
        "pip install '.[everything]'",
        "pytest tests/nothing",
        "cmake -DANYNET_SPEED=ON",
    ],
)
def test_mistakes_would_be_found(command: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises((Exception, SystemExit)) as error:
        check(shlex.split(command), False, monkeypatch)
    assert not isinstance(error.value, (TypeError, AttributeError, NameError))
