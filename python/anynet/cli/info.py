"""`anynet info`: what is installed and in use."""

from __future__ import annotations

import platform
from typing import Annotated, Any

import typer

from anynet.json_text import json_text


def info(
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object, for machines.")] = False,
) -> None:
    """What is installed: build, instruction set, threads, weights."""
    import anynet
    import anynet_ext
    from anynet.checkpoint import PACKAGED, load_metadata

    versions = {"anynet": anynet.__version__, "python": platform.python_version()}
    found: dict[str, Any] = {**versions, **anynet_ext.build_info()}
    found["weights"] = {file.stem: load_metadata(file) for file in sorted(PACKAGED.glob("*.safetensors"))}
    if as_json:
        print(json_text(found))
        return
    for name, value in found.items():
        print(f"{name}: {' '.join(map(str, value)) if isinstance(value, (list, dict)) else value}")
