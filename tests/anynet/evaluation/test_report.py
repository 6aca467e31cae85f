from __future__ import annotations

from anynet.evaluation import report
from anynet.evaluation.evaluate import Evaluation, Stage
from anynet.evaluation.metrics import Scores


def _evaluation(*d1s: float) -> Evaluation:
    stages = (Stage(i, (Scores(1, 2, 3, 4, d1, 100),), 10.0 * i, 100.0) for i, d1 in enumerate(d1s, 1))
    return Evaluation(("a",), tuple(stages))


def test_the_table_of_splits() -> None:
    table = report.splits_markdown([_evaluation(*d1s) for d1s in [(10, 5), (12, 5), (14, 5), (16, 5), (18, 5)]])
    assert "| 1 | 14.00 ± 3.16 | 10.0 |" in table
    assert "| 2 | 5.00 ± 0.00 | 20.0 |" in table
    assert "of 5 splits" in table


def test_every_image_has_an_entry() -> None:
    images = tuple(Scores(epe, 2, 3, 4, 5, 100) for epe in (1, 2, 3))
    evaluation = Evaluation(("a", "b", "a"), (Stage(1, images, 10.0, 100.0),))
    (entry,) = report.to_json({("method", "data", "all"): evaluation})
    assert {name: scores["epe"] for name, scores in entry["stages"][0]["images"].items()} == {"a": 1, "b": 2, "a_2": 3}


def test_the_table_counts_the_images_of_the_mean() -> None:
    images = Scores(1, 2, 3, 4, 5, 100), Scores(*[float("nan")] * 5, 0)
    evaluation = Evaluation(("a", "b"), (Stage(1, images, 10.0, 100.0),))
    assert "| foreground | 1 | 1 | 1.00 |" in report.markdown({("m", "data", "foreground"): evaluation})
