"""AnyNet: stereo depth that can be stopped at any moment."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from anynet.checkpoint import load_checkpoint, save_checkpoint
    from anynet.errors import AnyNetError
    from anynet.model.anynet import AnyNet
    from anynet.model.config import AnyNetConfig
    from anynet.predictor import Estimate, Predictor
    from anynet.worker import Worker

# Imported on first use, as the names are.
_PACKAGES = (
    "baselines", "camera", "data", "evaluation", "export", "io", "model", "streams", "synthetic", "training", "view",
)  # fmt: skip

__all__ = [
    "AnyNet",
    "AnyNetConfig",
    "AnyNetError",
    "Estimate",
    "Predictor",
    "Worker",
    "load_checkpoint",
    "save_checkpoint",
]

_MODULES = {
    "AnyNet": "model.anynet",
    "AnyNetConfig": "model.config",
    "AnyNetError": "errors",
    "Estimate": "predictor",
    "Predictor": "predictor",
    "Worker": "worker",
    "load_checkpoint": "checkpoint",
    "save_checkpoint": "checkpoint",
}


def __getattr__(name: str) -> Any:
    """Imports a public name on first use: the command line's help must not wait for torch."""
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("anynet")
        except PackageNotFoundError:
            return "0+source"  # imported from a source tree
    if name in _PACKAGES:
        return import_module(f"anynet.{name}")
    if name not in _MODULES:
        raise AttributeError(f"module 'anynet' has no attribute {name!r}")
    return getattr(import_module(f"anynet.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_PACKAGES, "__version__"})
