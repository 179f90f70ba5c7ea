"""Protocols of tracking: `ObjectTracker`, which assigns identities to detections, and `AppearanceModel`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from track_range.detection.detections import Descriptors, Detections
from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.foundation.sparse_flow import BackgroundFlow
from track_range.tracking.tracks import Tracks


class ObjectTracker(Protocol):
    """Assigns identities to the boxes of successive frames; all state belongs to the instance."""

    def update(self, detections: Detections, time_s: float, image: Image | None) -> Tracks:
        """The confirmed tracks at `time_s`, which must increase from call to call; `image` is (H, W, 3) BGR or None.

        Raises:
            ValueError: `time_s` is not later than in the previous call.
        """
        ...


@runtime_checkable
class RefinableTracker(ObjectTracker, Protocol):
    """A tracker with additional output for `track_range.tracking.offline_refinement`; optional.

    The tracks of other trackers are refined too, but without the boxes from before a track's confirmation, and tracks
    with low scores are not dropped.
    """

    @property
    def tentative(self) -> Tracks:
        """The tracks detected in the last frame that are not confirmed yet."""
        ...

    def track_activation_threshold(self, class_id: IntArray) -> FloatArray:
        """(N,) minimum score at which a detection of a class (N,) starts a track."""
        ...


class AppearanceModel(Protocol):
    """Computes appearance embeddings of boxes: vectors of length 1 with small cosine distances for one object.

    Attributes:
        max_cosine_distance: largest cosine distance between two embeddings of one object.
        notes: messages for the user.
    """

    max_cosine_distance: float
    notes: tuple[str, ...]

    def embed(self, image: Image, xyxy_px: FloatArray) -> Descriptors:
        """(N, D) unit-norm embeddings of the boxes (N, 4) in `image`, (H, W, 3) uint8 BGR; zeros = unknown."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerOptions:
    """Options that the program passes to every new tracker.

    Attributes:
        reid: the user's re-identification network (`--reid`); None = the tracker's default appearance model, if any.
        flow: flow of the background, shared with the odometry of the run; None = none to share.
    """

    reid: AppearanceModel | None = None
    flow: BackgroundFlow | None = None
