"""Data sets by name, as configurations and the command line write them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from inspect import signature

from anynet.data.custom import folders, table
from anynet.data.kitti import kitti2012, kitti2015
from anynet.data.middlebury import eth3d, middlebury2001, middlebury2003, middlebury2006, middlebury2014
from anynet.data.rendered import Rendered, RenderedFolder
from anynet.data.scene_flow import scene_flow
from anynet.errors import AnyNetError
from anynet.samples import Concatenation, Dataset

# Their functions: the first parameter is the root, of `render` a number, and the others are the options.
OPENERS: dict[str, Callable[..., Dataset]] = {
    "rendered": RenderedFolder,
    "render": Rendered,
    "kitti2012": kitti2012,
    "kitti2015": kitti2015,
    "middlebury2001": middlebury2001,
    "middlebury2003": middlebury2003,
    "middlebury2005": middlebury2006,
    "middlebury2006": middlebury2006,
    "middlebury2014": middlebury2014,
    "eth3d": eth3d,
    "scene_flow": scene_flow,
    "folders": folders,
    "csv": table,
}


def open_dataset(spec: str) -> Dataset:
    """Opens `kind:root` or `kind:root?option=value&option=value`, e.g. `kitti2015:data/kitti2015?split=val.txt`.

    Raises AnyNetError for an unknown kind or option, and what the data set itself raises for a wrong root.
    """
    kind, colon, rest = spec.partition(":")
    if not colon or kind not in OPENERS:
        raise AnyNetError(
            f"data set {spec!r}: expected KIND:ROOT[?OPTION=VALUE&...] with KIND one of {', '.join(sorted(OPENERS))}"
        )
    root, _, query = rest.partition("?")
    parts = [part.partition("=")[::2] for part in query.split("&") if part]
    options = dict(parts)
    if len(options) < len(parts):
        raise AnyNetError(f"data set {spec!r}: expected each option once, got {query!r}")
    load = OPENERS[kind]
    known = list(signature(load).parameters)[1:]
    for option in options:
        if option not in known:
            expected = f"options among {', '.join(known)}" if known else "no options"
            raise AnyNetError(f"data set {spec!r}: expected {expected}, got {option!r}")
    try:
        if load is Rendered:
            return Rendered(_whole("the seed", root), **{name: _whole(name, value) for name, value in options.items()})
        return load(root, **options)
    except AnyNetError:
        raise
    except ValueError as error:  # no number
        raise AnyNetError(f"data set {spec!r}: {error}") from None


def _whole(name: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise AnyNetError(f"expected {name} as a whole number, got {text!r}") from None


def open_datasets(specs: Sequence[str]) -> Dataset:
    """All samples of several data sets, one after the other."""
    return joined([open_dataset(spec) for spec in specs])


def joined(datasets: Sequence[Dataset]) -> Dataset:
    """The same of data sets that are open."""
    if len(datasets) == 1:
        return datasets[0]
    return Concatenation("+".join(d.name for d in datasets), [(d, i) for d in datasets for i in range(len(d))])
