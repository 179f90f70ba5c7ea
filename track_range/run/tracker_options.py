"""The tracker that the options name."""

from __future__ import annotations

from pathlib import Path

from track_range.detection.models.onnx_session import Runtime
from track_range.run.settings import TrackerName
from track_range.tracking.appearance import ColourLayout, Descriptor
from track_range.tracking.deepsort import DeepSortTracker
from track_range.tracking.reid import ReidModel
from track_range.tracking.tracker_settings import AppearanceGates, TrackerSettings


def open_descriptor(name: TrackerName, reid: Path | None, runtime: Runtime | None = None) -> Descriptor | None:
    """Who says what boxes look like, where there are images: a network, else the built-in one; None for `sort`.

    Raises:
        ModelError: the file is no re-identification network.
    """
    if name == "sort":
        return None
    return ColourLayout() if reid is None else ReidModel(reid, runtime)


def new_tracker(name: TrackerName, descriptor: Descriptor | None) -> DeepSortTracker:
    """A tracker that has seen nothing; descriptors of a file count for `deepsort` only, too."""
    looks = AppearanceGates() if name == "deepsort" else AppearanceGates(max_distance=0.0)
    return DeepSortTracker(TrackerSettings(appearance=looks), descriptor=descriptor)
