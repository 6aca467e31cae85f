"""Streams: frames from cameras, videos, folders and recordings, computed as they come, to files, recordings, videos."""

from anynet.streams.capture import Capture
from anynet.streams.images import ImageFiles
from anynet.streams.recording import Recording
from anynet.streams.sinks import Recorder, Sink, Video
from anynet.streams.source import Frame, Source
from anynet.streams.stream import Result, Statistics, Stream

__all__ = [
    "Capture",
    "Frame",
    "ImageFiles",
    "Recorder",
    "Recording",
    "Result",
    "Sink",
    "Source",
    "Statistics",
    "Stream",
    "Video",
]
