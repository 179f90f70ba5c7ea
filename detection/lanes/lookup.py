"""Which lane finder a word of the command line means."""

from __future__ import annotations

from pathlib import Path

from track_range.detection.lanes.edges import EdgeLaneFinder
from track_range.detection.lanes.lines import LaneFinder
from track_range.detection.lanes.nets import NetLaneFinder
from track_range.detection.models.onnx_session import Runtime

CLASSICAL = "classical"
"""The word for the finder that needs no network."""


def open_lane_finder(word: str, runtime: Runtime | None = None) -> LaneFinder:
    """The classical finder, or the network in the file that the word names.

    Raises:
        ModelError: no such file, or no lane network.
    """
    return EdgeLaneFinder() if word == CLASSICAL else NetLaneFinder(Path(word), runtime)
