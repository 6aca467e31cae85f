"""Loading the compiled libraries."""

from __future__ import annotations

import pytest

from anynet_ext import _library


def test_missing_library(tmp_path, monkeypatch):
    monkeypatch.setattr(_library, "_FOLDER", tmp_path)
    with pytest.raises(ImportError, match=r"_C\.so is missing: build it with `pip install \.`"):
        _library._load("_C.so")
