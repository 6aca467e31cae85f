"""Hostile and damaged texts: one error of one line, soon, and nothing else."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np
import pytest

from anynet.camera import read_calibration
from anynet.camera.document import open_document
from anynet.camera.tree import Tree, json_document, numbers, xml_document, yaml_documents
from anynet.errors import AnyNetError


def test_yaml_of_opencv_and_others() -> None:
    text = (
        "%YAML:1.0\n---\nCamera.fx:\t3.\nD:[1., .5]\nmap: {a: 1, b: [x, y]}\nsame: &s [1]\nagain: *s\n---\nsecond: 1\n"
    )
    assert yaml_documents(text) == [
        {"Camera.fx": "3.", "D": ["1.", ".5"], "map": {"a": "1", "b": ["x", "y"]}, "same": ["1"], "again": ["1"]},
        {"second": "1"},
    ]


def test_xml() -> None:
    assert xml_document("<s><a>1 2</a><b><_>x</_><_>y</_></b><c><d>3</d></c></s>") == {
        "a": "1 2", "b": ["x", "y"], "c": {"d": "3"},
    }  # fmt: skip


def test_json() -> None:
    assert json_document('{"a": [1, 2.50, NaN], "b": {"c": "x"}}') == {"a": ["1", "2.50", "NaN"], "b": {"c": "x"}}


def test_numbers() -> None:
    assert numbers("[1 2; 3, 4]", "m").tolist() == [1, 2, 3, 4]
    assert numbers([["1", "2"], ["3"]], "m", 3).tolist() == [1, 2, 3]
    assert numbers({"rows": "1", "cols": "2", "dt": "2d", "data": ["1", "2", "3", "4"]}, "m").size == 4
    assert numbers({"sizes": ["1", "2"], "data": ["1", "2"]}, "m").size == 2
    assert np.isinf(numbers(".Inf", "m", 1)[0])


@pytest.mark.parametrize(
    ("node", "message"),
    [
        ({"rows": "2", "dt": "d", "data": ["1", "2"]}, "expected m to have rows, cols and data"),
        ({"rows": "2", "cols": "2", "dt": "d", "data": ["1", "2"]}, "expected m to be 2 x 2 numbers .*, got 2"),
        ({"rows": "1e9", "cols": "2", "data": ["1"]}, "whole numbers of rows and columns"),
        ({"rows": "nan", "cols": "2", "data": ["1"]}, "whole numbers of rows and columns"),
        ({"a": "1"}, "expected m to be numbers, got a map of a"),
        ("one", "expected m to be 4 numbers, got 'one'"),
        ("1 2 3", "expected m to be 4 numbers, got 3"),
    ],
)
def test_what_is_no_matrix(node: object, message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        numbers(node, "m", 4)  # type: ignore[arg-type]


LAUGHS = "a: &a [x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 8)}]\n" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    "text",
    [
        "%YAML:1.0\n---\na: " + "[" * 200_000,
        "%YAML:1.0\n---\na: " + "{b: " * 100_000,
        "%YAML:1.0\n---\n" + "- " * 100_000 + "x",
        "%YAML:1.0\n---\nQ: !!opencv-matrix\n   rows: 4\n   dt: d\n   data: [" + "1, " * 2000 + "1]\n",
        "%YAML:1.0\n---\nQ: !!opencv-matrix\n   rows: 4\n   co\udc80ls: 4\n   dt: d\n   data: [1]\n",
        "%YAML:1.0\n---\nT: " + LAUGHS,
        "%YAML:1.0\n---\n" + LAUGHS + "K: *i\nT: *i\n",
        "%YAML:1.0\n---\na: &a [*a]\nK: *a\n",
        "%YAML:1.0\n---\n? [a, b]\n: 1\n",
        "<a>" * 200_000,
        '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "b">]><x>&a;</x>',
        '<?xml version="1.0"?><o><Q type_id="opencv-matrix"><rows>4</rows><dt>d</dt><data>'
        + "1 " * 2000
        + "</data></Q></o>",
        '{"a": ' + "[" * 200_000,
        '{"Q": ' + "9" * 20_000 + "}",
        "cam0=x" + " " * 60_000 + "y\nbaseline=1\ndoffs=0\n",
        "P2: x" + " " * 60_000 + "y\nP3: 1\n",
        "cam0=" + "[" * 60_000 + "\nbaseline=1\ndoffs=0\n",
        "S_rect_02: nan 375\nP_rect_02: 7 0 6 0 0 7 1 0 0 0 1 0\nP_rect_03: 7 0 6 -3 0 7 1 0 0 0 1 0\n",
        "cam0=[900 0 300; 0 900 250; 0 0 1]\ndoffs=3\nbaseline=100\nwidth=inf\nheight=2\n",
        "cam0=[900 0 300; 0 900 250; 0 0 1]\ndoffs=3\nbaseline=100\nwidth=-4\nheight=2\n",
        "cam0=[9e9 0 300; 0 9e9 250; 0 0 1]\ndoffs=3\nbaseline=100\n",
        "cam0=[900 0 300; 0 900 250; 0 0 1]\ndoffs=3\nbaseline=1e12\n",
        "\0" * 1000,
        "%YAML:1.0\n---\n\0",
        "%YAML",
        "{",
        "<",
        "[a]\n",
    ],
    ids=range(28),
)
def test_hostile_texts(tmp_path: Path, text: str) -> None:
    path = tmp_path / "calib.txt"
    path.write_bytes(text.encode(errors="surrogateescape"))
    start = time.process_time()
    with pytest.raises(AnyNetError) as error:
        read_calibration(path)
    assert time.process_time() - start < 10
    assert len(str(error.value)) < 1000
    assert "\n" not in str(error.value)


MIDDLEBURY = "cam0=[900 0 300; 0 900 250; 0 0 1]\ndoffs=3\nbaseline=100\n"
MATRIX = "<T><rows>1</rows><cols>3</cols><dt>d</dt><data>{} 0 0</data></T>"


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (MIDDLEBURY + "baseline=386.002\n", "baseline"),
        ("[STEREO]\nBaseline=120\n[LEFT_CAM_HD]\nfx=1\n[STEREO]\nBaseline=63\n", "Baseline"),
        ("STEREO=1\n[STEREO]\nBaseline=63\n", "STEREO"),
        ("P2: 7 0 6 0 0 7 1 0 0 0 1 0\nP2: 8 0 6 0 0 8 1 0 0 0 1 0\n", "P2"),
        ("%YAML:1.0\n---\nT: [-0.1, 0, 0]\nT: [-0.2, 0, 0]\n", "T"),
        ("stereo:\n  T: -0.1 0 0\n  T: -0.2 0 0\n", "T"),
        ('{"stereo": {"T": [-0.1, 0, 0], "T": [-0.2, 0, 0]}}', "T"),
        (f"<opencv_storage>{MATRIX.format(-0.1)}{MATRIX.format(-0.2)}</opencv_storage>", "T"),
        (LAUGHS + re.sub(r"\b[a-i]\b", r"z\g<0>", LAUGHS) + "K: *i\nK: *zi\n", "K"),  # alike, but too much to compare
    ],
)
def test_a_field_that_stands_twice(tmp_path: Path, text: str, name: str) -> None:
    path = tmp_path / "calib.txt"
    path.write_text(text)
    with pytest.raises(AnyNetError, match=f"calib.txt: expected {name} once, got it twice"):
        open_document(path)


@pytest.mark.parametrize(
    ("text", "tree"),
    [
        ("[A]\nx=1\n[B]\nx=2\n[A]\nx=1\ny=3\n", {"A": {"x": "1", "y": "3"}, "B": {"x": "2"}}),
        ("P2: 7 0 6\nP2: 7 0 6\n", {"P2": "7 0 6"}),
        ("left: {K: 1}\nright: {K: 2}\n---\nleft: {K: 3}\n", {"left": {"K": "1"}, "right": {"K": "2"}}),
        ("- {K: 1}\n- {K: 2}\n", [{"K": "1"}, {"K": "2"}]),
        ("a: &a {x: 1}\nb: {<<: *a, x: 2, <<: *a}\n", {"a": {"x": "1"}, "b": {"<<": {"x": "1"}, "x": "2"}}),
        ("<s><l><K>1</K></l><r><K>2</K></r><K>3</K><K>3</K></s>", {"l": {"K": "1"}, "r": {"K": "2"}, "K": "3"}),
        ('{"l": {"K": 1}, "r": {"K": 2}, "n": 5, "n": 5}', {"l": {"K": "1"}, "r": {"K": "2"}, "n": "5"}),
    ],
)
def test_names_that_may_stand_twice(tmp_path: Path, text: str, tree: Tree) -> None:
    path = tmp_path / "calib.txt"
    path.write_text(text)
    assert open_document(path).tree == tree


@pytest.mark.parametrize(
    ("text", "tree"),
    [
        ("K: [1, 2] // of the left\nT: 3\n", {"K": ["1", "2"], "T": "3"}),
        ("// one\n%YAML:1.0\n---\nK: 1\n  // two: \"three\nT: [1, // x\n  2]\n", {"K": "1", "T": ["1", "2"]}),
        ("a: http://x\nb: 'it''s // so' // no\nc: it's // no\n", {"a": "http://x", "b": "it's // so", "c": "it's"}),
        ('a: "1\n  // 2 \\" // 3" // no\nb: 4 # don\'t "\nc: 5 // no\n', {"a": '1 // 2 " // 3', "b": "4", "c": "5"}),
        ('// one\n{"a": "x // y", // two\n "b": "http://z", // three\n "c": [1] }',
         {"a": "x // y", "b": "http://z", "c": ["1"]}),
        ('{ // one\n  // two\n "c": 1 }\n// three\n', {"c": "1"}),
        ('# one\n{"a": "x # // y" } // two\n', {"a": "x # // y"}),
    ],
)  # fmt: skip
def test_comments_by_slashes(tmp_path: Path, text: str, tree: Tree) -> None:
    path = tmp_path / "calib.txt"
    path.write_text(text)
    assert open_document(path).tree == tree


def test_a_file_that_is_too_large(tmp_path: Path) -> None:
    path = tmp_path / "calib.yml"
    with path.open("wb") as file:
        file.truncate(100 << 20)
    with pytest.raises(AnyNetError, match="below 32 MB"):
        open_document(path)


def test_maps_of_a_rectification_beside_the_matrices(tmp_path: Path) -> None:
    """Some write them, 300,000 numbers each; they are neither needed nor in the way."""
    path = tmp_path / "calib.yml"
    data = ", ".join(["1.5"] * 640 * 480)
    text = f"%YAML:1.0\n---\nmap1x: !!opencv-matrix\n   rows: 480\n   cols: 640\n   dt: f\n   data: [ {data} ]\n"
    text += (
        "K: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [500., 0., 320., 0., 500., 240., 0., 0., 1.]\n"
    )
    path.write_text(text + "T: [-0.1, 0., 0.]\n")
    assert read_calibration(path).baseline == pytest.approx(0.1)
