"""Weights of version 0.1: its names of options and tensors in today's."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

_OPTIONS = {
    "input_scale": "input_scale",
    "groups": "groups",
    "channels": "features.channels",
    "blocks": "features.blocks",
    "layers": "features.layers",
    "hourglass": "first_stage.hourglass",
    "finer_costs": "first_stage.fine_costs",
    "guided": "first_stage.excitation",
    "neighbours": "residual_stages.candidate_radius",
    "reversed_residuals": "residual_stages.reverse",
    "spn_channels": "refinement.channels",
    "spn_directions": "refinement.directions",
    "spn_fill": "refinement.fill_occlusions",
    "spn_mismatch": "refinement.warp_error",
    "spn_upsampling": "refinement.convex_upsampling",
}

_TENSORS = [
    (r"cost_nets\.0\.", "first_stage.network."),
    (r"cost_nets\.1\.", "residual_stages.0.network."),
    (r"cost_nets\.2\.", "residual_stages.1.network."),
    (r"updates\.(\d)\.layers\.", r"residual_stages.\1.network."),
    (r"finer_costs\.", "first_stage.fine_costs."),
]
_HOURGLASS = {"halve": "down", "inside": "inner", "last": "up", "gate": "excitation"}


def is_legacy(options: Mapping[str, Any]) -> bool:
    """Whether a stored configuration is of that version: flat, not by parts."""
    return "cost_channels" in options


def upgrade_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Its options by parts; what is unknown stays, and is told by who reads it."""
    new: dict[str, Any] = {"first_stage": {}, "residual_stages": {}, "features": {}, "refinement": {}}
    for name, value in options.items():
        if name in ("ranges", "cost_channels"):
            option = "range" if name == "ranges" else "channels"
            new["first_stage"][option], *rest = value
            new["residual_stages"]["ranges" if name == "ranges" else "channels"] = rest
        elif name == "cost_layers":
            new["first_stage"]["layers"] = new["residual_stages"]["layers"] = value
        elif name == "spn_combine" and value == "max":
            pass  # the only way there is
        else:
            part, _, option = _OPTIONS.get(name, name).rpartition(".")
            (new[part] if part else new)[option] = value
    return new


def upgrade_name(name: str) -> str:
    """A tensor's name."""
    if name.startswith(("features.", "refinement.")):
        return name
    for pattern, new in _TENSORS:
        name, count = re.subn("^" + pattern, new, name)
        if count:
            break
    return ".".join(_HOURGLASS.get(part, part) for part in name.split("."))
