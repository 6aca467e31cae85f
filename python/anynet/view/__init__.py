"""The page `anynet view`: disparity, confidence and cloud live, to turn and to try settings on (extra `view`)."""

from anynet.view.page import Page, Settings
from anynet.view.view import StillPair, View

__all__ = ["Page", "Settings", "StillPair", "View"]
