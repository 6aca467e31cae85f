"""Data sets: every one is a sequence of StereoSample."""

from anynet.data.registry import open_dataset, open_datasets
from anynet.samples import Dataset, RenderedSample, StereoSample

__all__ = ["Dataset", "RenderedSample", "StereoSample", "open_dataset", "open_datasets"]
