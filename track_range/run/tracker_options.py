"""The options that every tracker of a run is made from."""

from __future__ import annotations

from pathlib import Path

from track_range.detection.models.onnx_session import Runtime
from track_range.tracking.reid import ReidModel
from track_range.tracking.tracker import TrackerOptions


def open_tracker_options(reid: Path | None, runtime: Runtime | None = None) -> TrackerOptions:
    """The options, with the re-identification network loaded where there is one.

    Raises:
        ModelError: the file is no re-identification network.
    """
    return TrackerOptions(reid=None if reid is None else ReidModel(reid, runtime))
