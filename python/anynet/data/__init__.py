"""Data sets: every one is a sequence of StereoSample."""

from anynet.data.registry import open_dataset, open_datasets
from anynet.data.sample import Dataset, StereoSample

__all__ = ["Dataset", "StereoSample", "open_dataset", "open_datasets"]
