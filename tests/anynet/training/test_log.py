from __future__ import annotations

import json
from pathlib import Path

import pytest

from anynet.evaluation.evaluate import Evaluation, Stage
from anynet.evaluation.metrics import Scores
from anynet.training.log import RunLog


def lines(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def step(log: RunLog, number: int, loss: float) -> None:
    log.step(number, [loss, 2 * loss], grad_norm=loss, learning_rate=1e-3, seconds=loss / 2, waited=0.0)


def test_a_line_is_the_mean_of_its_steps(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with RunLog(path, 0, 5, every=2, tensorboard=None) as log:
        for number, loss in enumerate([1.0, 3.0, 2.0, 4.0, 8.0], start=1):
            step(log, number, loss)
    found = lines(path)
    assert [line["step"] for line in found] == [2, 4, 5]  # the last step ends its line
    assert [line["losses"] for line in found] == [[2, 4], [3, 6], [8, 16]]
    assert [line["grad_norm"] for line in found] == [2, 3, 8]
    assert found[0] == {
        "step": 2, "losses": [2, 4], "grad_norm": 2, "learning_rate": 1e-3, "seconds": 1, "waited": 0,
    }  # fmt: skip


def test_lines_beyond_the_checkpoint_are_dropped(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    path.write_text('{"step": 1}\n{"step": 2}\n{"step": 3}\n{"st')
    with RunLog(path, 2, 4, every=1, tensorboard=None) as log:
        step(log, 3, 1.0)
    assert [line["step"] for line in lines(path)] == [1, 2, 3]
    assert "losses" in lines(path)[2]


@pytest.mark.parametrize("damage", ["1" + 400 * "0", "1" + 5000 * "0", '"nan', "[" * 3000, "{}"])
def test_damaged_lines_are_dropped(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "log.jsonl"
    path.write_text(f'{{"step": 1}}\n{{"step": {damage}}}\n')
    with RunLog(path, 2, 4, every=1, tensorboard=None):
        pass
    assert lines(path) == [{"step": 1}]


def test_validations(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    stages = tuple(Stage(n, (Scores(n, 2, 3, 4, 10 * n, 100),), 1.0, 100.0) for n in (1, 2))
    with RunLog(path, 0, 1, every=1, tensorboard=None) as log:
        log.validation(7, {"kitti": Evaluation(("a",), stages)})
    assert lines(path) == [{"step": 7, "validation": "kitti", "d1": [10, 20], "epe": [1, 2]}]


def test_no_file_no_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with RunLog(None, 0, 1, every=1, tensorboard=None) as log:
        step(log, 1, 1.0)
    assert capsys.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


def test_names_with_brackets_and_long_lines_stay_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = "folders:" + "a long folder/" * 8 + "v[/1][red]"
    stage = Stage(1, (Scores(1, 2, 3, 4, 5, 100),), 10.0, 100.0)
    with RunLog(tmp_path / "log.jsonl", 0, 2, every=1, tensorboard=None) as log:
        log.validation(1, {name: Evaluation(("a",), (stage,))})
    assert f"step 1  {name}  D1 5.00 %  EPE 1.00 px" in capsys.readouterr().err
