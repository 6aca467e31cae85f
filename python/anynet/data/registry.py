"""Data sets by name, as configurations and the command line write them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from anynet.data.custom import folders, table
from anynet.data.kitti import kitti2012, kitti2015
from anynet.data.middlebury import eth3d, middlebury2001, middlebury2003, middlebury2006, middlebury2014
from anynet.data.rendered import Rendered, RenderedFolder
from anynet.data.scene_flow import scene_flow
from anynet.errors import AnyNetError
from anynet.samples import Concatenation, Dataset

Options = dict[str, str]


def _render(count: str, options: Options) -> Dataset:
    return Rendered(int(count), **{key: int(value) for key, value in options.items()})


def _files(load: Callable[..., Dataset]) -> Callable[[str, Options], Dataset]:
    return lambda root, options: load(root, **options)


OPENERS: dict[str, Callable[[str, Options], Dataset]] = {
    "rendered": _files(RenderedFolder),
    "render": _render,
    "kitti2012": _files(kitti2012),
    "kitti2015": _files(kitti2015),
    "middlebury2001": _files(middlebury2001),
    "middlebury2003": _files(middlebury2003),
    "middlebury2005": _files(middlebury2006),
    "middlebury2006": _files(middlebury2006),
    "middlebury2014": _files(middlebury2014),
    "eth3d": _files(eth3d),
    "scene_flow": _files(scene_flow),
    "folders": _files(folders),
    "csv": _files(table),
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
    options = dict(part.partition("=")[::2] for part in query.split("&") if part)
    try:
        return OPENERS[kind](root, options)
    except AnyNetError:
        raise
    except (TypeError, ValueError) as error:  # an option that there is not, or that is no number
        raise AnyNetError(f"data set {spec!r}: {error}") from None


def open_datasets(specs: Sequence[str]) -> Dataset:
    """All samples of several data sets, one after the other."""
    datasets = [open_dataset(spec) for spec in specs]
    if len(datasets) == 1:
        return datasets[0]
    return Concatenation("+".join(d.name for d in datasets), [(d, i) for d in datasets for i in range(len(d))])
