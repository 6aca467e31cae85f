"""YAML, XML and JSON texts as one kind of tree: maps, lists, and texts at the leaves.

Whatever the text, nothing recurses and nothing is evaluated: a hostile file ends in one error. OpenCV's own reader is
not used on purpose: a matrix without `cols` corrupts its memory, and deep nesting its stack.
"""

from __future__ import annotations

import json
import re
import xml.parsers.expat
from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt
import yaml

from anynet.errors import AnyNetError

Tree = dict[str, "Tree"] | list["Tree"] | str
Matrix = npt.NDArray[np.float64]

_DEEPEST = 40
_MOST = 10_000  # numbers of a field, and fields of a file
_YAML = getattr(yaml, "CBaseLoader", yaml.BaseLoader)


def put(fields: dict[str, Tree], name: str, node: Tree) -> None:
    """Adds a field to a map.

    Raises:
        AnyNetError: if it is there already, unless as the same text: which one is meant is not for us to guess.
    """
    # Maps and lists are not compared: a hostile file's aliases make that endless. YAML may have several merges.
    if name in fields and name != "<<" and (isinstance(node, (dict, list)) or fields[name] != node):
        raise AnyNetError(f"expected {shortened(name)} once, got it twice")
    fields[name] = node


class _Builder:
    """Grows a tree from events, without recursion."""

    def __init__(self) -> None:
        self.root: Tree | None = None
        self._open: list[tuple[dict[str, Tree] | list[Tree], str | None, str | None]] = []
        self._key: str | None = None

    def add(self, node: Tree) -> None:
        if not self._open:
            self.root = node
            return
        container = self._open[-1][0]
        if isinstance(container, list):
            container.append(node)
        elif self._key is None:
            if not isinstance(node, str):
                raise AnyNetError("expected names of fields to be plain texts")
            self._key = node
        else:
            put(container, self._key, node)
            self._key = None

    def begin(self, container: dict[str, Tree] | list[Tree], anchor: str | None) -> None:
        if len(self._open) == _DEEPEST:
            raise AnyNetError(f"expected at most {_DEEPEST} levels of nesting")
        self._open.append((container, self._key, anchor))
        self._key = None

    def end(self, anchors: dict[str, Tree]) -> None:
        container, self._key, anchor = self._open.pop()
        if anchor:
            anchors[anchor] = container  # not before, so that nothing contains itself
        self.add(container)


def yaml_documents(text: str) -> list[Tree]:
    """The documents of a YAML text, OpenCV's dialect included; those that are empty are left out.

    Raises:
        AnyNetError: if it is no YAML, or says different things of one name.
    """
    text = re.sub(r"\A%YAML[^\n]*\n", "", text).replace("\t", "  ")
    text = re.sub(r"^( *[\w.]+):(?=[^\s:/\\])", r"\1: ", text, flags=re.MULTILINE)  # OpenCV needs no blank there
    documents: list[Tree] = []
    builder = _Builder()
    anchors: dict[str, Tree] = {}
    try:
        for event in yaml.parse(text, Loader=_YAML):
            if isinstance(event, yaml.ScalarEvent):
                builder.add(event.value)
                if event.anchor:
                    anchors[str(event.anchor)] = event.value
            elif isinstance(event, (yaml.MappingStartEvent, yaml.SequenceStartEvent)):
                container: dict[str, Tree] | list[Tree] = {} if isinstance(event, yaml.MappingStartEvent) else []
                builder.begin(container, event.anchor)
            elif isinstance(event, (yaml.MappingEndEvent, yaml.SequenceEndEvent)):
                builder.end(anchors)
            elif isinstance(event, yaml.AliasEvent):
                builder.add(anchors[str(event.anchor)])
            elif isinstance(event, yaml.DocumentEndEvent):
                if builder.root not in (None, "", {}, []):
                    assert builder.root is not None
                    documents.append(builder.root)
                builder, anchors = _Builder(), {}
    except yaml.MarkedYAMLError as error:
        where = "" if error.problem_mark is None else f" in line {error.problem_mark.line + 1}"
        raise AnyNetError(f"damaged YAML{where}: {error.problem}") from error
    except (yaml.YAMLError, KeyError, UnicodeError, ValueError) as error:
        if isinstance(error, AnyNetError):
            raise
        raise AnyNetError("damaged YAML") from error
    return documents


def xml_document(text: str) -> Tree:
    """The content of an XML text's root: elements by their names, those named `_` as a list.

    Raises:
        AnyNetError: if it is no XML, says different things of one name, or has a document type (of no use here).
    """
    levels: list[tuple[dict[str, Tree], list[str]]] = [({}, [])]

    def start(name: str, _: dict[str, str]) -> None:
        if len(levels) > _DEEPEST:
            raise AnyNetError(f"expected at most {_DEEPEST} levels of nesting")
        levels.append(({}, []))

    def end(name: str) -> None:
        children, words = levels.pop()
        node: Tree = children or "".join(words).strip()
        if list(children) == ["_"]:
            node = children["_"] if isinstance(children["_"], list) else [children["_"]]
        siblings = levels[-1][0]
        if name != "_" or name not in siblings:
            put(siblings, name, node)
        elif isinstance(siblings[name], list):
            siblings[name].append(node)  # type: ignore[union-attr]
        else:
            siblings[name] = [siblings[name], node]

    def refuse(*_: object) -> None:
        raise AnyNetError("expected XML without a document type")

    parser = xml.parsers.expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = lambda data: levels[-1][1].append(data)
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(re.sub(r"\A<\?xml[^>]*\?>", "", text).encode(), True)  # the text is decoded already
    except (xml.parsers.expat.ExpatError, UnicodeError) as error:
        raise AnyNetError(f"damaged XML: {error}") from error
    ((root, _),) = levels
    return next(iter(root.values()))


def json_document(text: str) -> Tree:
    """A JSON text, its numbers as the texts they are.

    Raises:
        AnyNetError: if it is no JSON, or says different things of one name.
    """
    leaf: Callable[[str], str] = str

    def fields(pairs: list[tuple[str, Tree]]) -> dict[str, Tree]:
        once: dict[str, Tree] = {}
        for name, node in pairs:
            put(once, name, node)
        return once

    try:
        value = json.loads(text, parse_int=leaf, parse_float=leaf, parse_constant=leaf, object_pairs_hook=fields)
    except AnyNetError:
        raise
    except json.JSONDecodeError as error:
        raise AnyNetError(f"damaged JSON in line {error.lineno}: {error.msg}") from error
    except (RecursionError, ValueError) as error:
        raise AnyNetError("damaged JSON") from error
    return value if isinstance(value, (dict, list)) else str(value)


def walk(tree: Tree) -> Iterator[tuple[tuple[str, ...], Tree]]:
    """Every map's entries, with the names that lead to them, outer ones first; lists are not entered."""
    waiting: list[tuple[tuple[str, ...], Tree]] = [((), tree)]
    for visited, (path, node) in enumerate(waiting):
        if visited == _MOST:
            raise AnyNetError(f"expected at most {_MOST} fields")
        if path:
            yield path, node
        if isinstance(node, dict) and len(path) < _DEEPEST:
            waiting.extend(((*path, name), child) for name, child in node.items())


def number(text: Tree) -> float | None:
    """A leaf as a number; None if it is none."""
    if not isinstance(text, str):
        return None
    try:
        return float(text)
    except ValueError:
        return {".inf": np.inf, "-.inf": -np.inf, ".nan": np.nan}.get(text.strip().lower())


def numbers(node: Tree, name: str, count: int | None = None) -> Matrix:
    """All numbers of a field, row by row: of a text, of lists in lists, or of a matrix (rows, cols, data).

    Raises:
        AnyNetError: if it is not numbers, or not `count` of them, or a matrix's data are not rows times columns.
    """
    values: list[float] = []
    texts: list[str] = []
    waiting = [_data(node, name)]
    visited = 0
    while waiting:
        item = waiting.pop()
        visited += 1
        if isinstance(item, list):
            if len(item) + len(waiting) + visited > 2 * _MOST:
                raise AnyNetError(f"expected {name} to be a matrix, got thousands of numbers")
            waiting.extend(reversed(item))
        elif isinstance(item, str):
            texts.append(item)
            words = re.split(r"[\s,;\[\]()]+", item)
            for word in filter(None, words):
                value = number(word)
                if value is None:
                    wanted = "numbers" if count is None else f"{count} numbers"
                    raise AnyNetError(f"expected {name} to be {wanted}, got {shortened(item)!r}")
                values.append(value)
        else:
            raise AnyNetError(f"expected {name} to be numbers, got a map of {shortened(', '.join(map(str, item)))}")
    if count is not None and len(values) != count:
        with_points = _with_decimal_commas(" ".join(texts))
        if len(with_points) == count:
            return np.array(with_points, np.float64)
        raise AnyNetError(f"expected {name} to be {count} numbers, got {len(values)}")
    return np.array(values, np.float64)


def _with_decimal_commas(text: str) -> list[float]:
    """The numbers of a text whose commas are decimal points; none if they cannot be."""
    if "." in text or not re.search(r"\d,\d", text):
        return []
    values = [number(word) for word in filter(None, re.split(r"[\s;\[\]()]+", text.replace(",", ".")))]
    return [value for value in values if value is not None]


def _data(node: Tree, name: str) -> Tree:
    """The list of a matrix's numbers, checked against its rows and columns; other nodes as they are."""
    if not isinstance(node, dict) or "data" not in node:
        return node
    if "sizes" in node:  # OpenCV's arrays of more dimensions
        sizes = numbers(node["sizes"], f"{name}'s sizes")
    elif "rows" in node and "cols" in node:
        sizes = np.concatenate([numbers(node[side], f"{name}'s {side}", 1) for side in ("rows", "cols")])
    else:
        raise AnyNetError(f"expected {name} to have rows, cols and data, got {shortened(', '.join(map(str, node)))}")
    if not all(1 <= size <= 1e6 and size == int(size) for size in sizes):
        raise AnyNetError(f"expected {name} to have whole numbers of rows and columns")
    channels = 1
    kind = node.get("dt", "")
    if isinstance(kind, str) and kind[:-1].isdigit() and len(kind) < 5:
        channels = int(kind[:-1])
    elif isinstance(kind, str) and len(kind) > 1:
        channels = len(kind)  # "ff" is "2f"
    data = node["data"]
    if isinstance(data, str):
        data = [word for word in re.split(r"[\s,]+", data) if word]
    expected = channels * np.prod(sizes, dtype=np.float64)
    if isinstance(data, list) and all(isinstance(item, str) for item in data) and len(data) != expected:
        shape = " x ".join(f"{size:.0f}" for size in sizes)
        raise AnyNetError(f"expected {name} to be {shape} numbers as its rows and cols say, got {len(data)}")
    return data


def shortened(text: str) -> str:
    """At most 60 characters, for messages."""
    return text if len(text) <= 60 else text[:57] + "..."
