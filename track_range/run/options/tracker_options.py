"""Options that are passed to every tracker of a run."""

from __future__ import annotations

from pathlib import Path

from track_range.detection.models.onnx_session import Runtime
from track_range.tracking.appearance.reid import ReidModel
from track_range.tracking.tracker import TrackerOptions


def open_tracker_options(reid: Path | None, runtime: Runtime | None = None) -> TrackerOptions:
    """Options for trackers, with the re-identification network loaded if there is one.

    Raises:
        ModelError: the file is not a usable re-identification network.
    """
    return TrackerOptions(reid=None if reid is None else ReidModel(reid, runtime))
