"""A calibration file as its reader sees it: what kind of text it is, and its content as a tree."""

from __future__ import annotations

import codecs
import os
import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from anynet.camera.tree import Tree, json_document, put, xml_document, yaml_documents
from anynet.errors import AnyNetError
from anynet.io.files import read_bytes

_LARGEST = 32 << 20  # bytes: some write the maps of a rectification into their files
_MARKS = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}
_COMMENT = re.compile(r"\s(#|//).*")
_COMMENT_LINES = re.compile(r"^\s*#.*$", re.MULTILINE)
_SLASHES = re.compile(  # comments by them; what may hold slashes that begin none is kept as group 1
    r"""(?<![^\s\[{,:])("[^"\\]*(?:\\[\s\S][^"\\]*)*"|(?:'[^']*')+|#.*)|(?<!\S)//.*"""
)
_FIELD = re.compile(r"([A-Za-z]\w*)[ \t]*([=:])")


@dataclass(frozen=True)
class Document:
    """One file.

    Attributes:
        path: the file.
        kind: "yaml", "xml" or "json"; "ini": NAME=VALUE, also in [sections]; "lines": NAME: NUMBERS, as KITTI's;
            "numbers": nothing else.
        tree: its content. Of "ini": sections as maps beside what is in none; of "numbers": a list with a text a line.
    """

    path: Path
    kind: str
    tree: Tree

    @property
    def fields(self) -> dict[str, Tree]:
        """The outermost names, none if it has no such."""
        return self.tree if isinstance(self.tree, dict) else {}


def open_document(path: str | Path) -> Document:
    """Reads a file and tells what kind of text it is, by its content alone.

    Raises:
        AnyNetError: if it cannot be read, is damaged, or is no text of those kinds.
    """
    path = Path(path)
    if os.path.isfile(path) and path.stat().st_size > _LARGEST:
        raise AnyNetError(f"{path}: expected a calibration below {_LARGEST >> 20} MB, got {path.stat().st_size} bytes")
    text = decode(read_bytes(path))
    try:
        kind, tree = _parse(text)
    except AnyNetError as error:
        raise AnyNetError(f"{path}: {error}") from error
    return Document(path, kind, tree)


def decode(data: bytes) -> str:
    """The text of a file in UTF-8, or in what its byte-order mark says; without the mark."""
    for mark, encoding in _MARKS.items():
        if data.startswith(mark):
            return data[len(mark) :].decode(encoding, errors="replace")
    return data.decode("utf-8", errors="replace")


def _parse(text: str) -> tuple[str, Tree]:
    stripped = text.lstrip()
    if stripped.startswith("<"):
        return "xml", xml_document(stripped)
    if "//" in stripped:  # YAML and JSON do not know these comments
        stripped = _SLASHES.sub(r"\1", stripped).lstrip()
    bare = _COMMENT_LINES.sub("", stripped).lstrip() if stripped.startswith("#") else stripped
    if bare.startswith("{"):
        try:
            return "json", json_document(bare)
        except AnyNetError:
            with suppress(AnyNetError):  # YAML may be written like it
                return "yaml", _first(yaml_documents(bare))
            raise
    if stripped.startswith(("%YAML", "---")):
        return "yaml", _first(yaml_documents(stripped))
    lines = [_COMMENT.sub("", line).strip() for line in stripped.splitlines()]
    lines = [line for line in lines if line and not line.startswith(("#", ";"))]
    if lines and all(map(_is_numbers, lines)):
        return "numbers", list(map(_with_points, lines) if _has_decimal_commas(lines) else lines)
    signs = [match.group(2) for line in lines if (match := _FIELD.match(line))]
    if signs and signs.count("=") * 2 > len(signs):
        return "ini", _sections(lines)
    if lines and re.match(r"(P|S|K|R|D|T)(_rect)?_?\d+(_roi)?[ \t]*:[ \t]*[-+.\d]|calib_time", _first_line(lines)):
        return "lines", _named(lines)
    return "yaml", _first(yaml_documents(stripped))


def _first(documents: list[Tree]) -> Tree:
    return documents[0] if documents else ""


def _first_line(lines: list[str]) -> str:
    """The first with a name of a matrix in it: KITTI's files begin with other fields at times."""
    return next((line for line in lines if re.match(r"P(_rect_)?\d", line)), lines[0])


def _has_decimal_commas(lines: list[str]) -> bool:
    """Whether commas stand for decimal points: numbers are apart without them, and none has a point."""
    text = " ".join(lines)
    return "." not in text and re.search(r"\d,\d", text) is not None and text.count(" ") >= 8


def _with_points(line: str) -> str:
    return line.replace(",", ".")


def _is_numbers(line: str) -> bool:
    words = re.sub(r"[\[\](),;]", " ", line).split()
    try:
        return bool(words) and all(float(word) is not None for word in words)
    except ValueError:
        return False


def _named(lines: list[str]) -> dict[str, Tree]:
    fields: dict[str, Tree] = {}
    for line in lines:
        _add(fields, line, ":")
    return fields


def _sections(lines: list[str]) -> dict[str, Tree]:
    root: dict[str, Tree] = {}
    sections: dict[str, dict[str, Tree]] = {}
    section = root
    for line in lines:
        if line.startswith("[") and line.endswith("]"):
            name = line[1:-1].strip()
            if name not in sections:
                sections[name] = {}
                put(root, name, sections[name])
            section = sections[name]  # the same one if its name stands twice
        else:
            _add(section, line, "=")
    return root


def _add(fields: dict[str, Tree], line: str, sign: str) -> None:
    name, found, value = line.partition(sign)
    if found:
        put(fields, name.strip(), value.strip())
