"""Protocols of tracking: `Tracker`, between detections and identities, and `AppearanceModel`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from track_range.detection.detections import Descriptors, Detections
from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.tracking.tracks import Tracks


class Tracker(Protocol):
    """Gives the boxes of successive frames identities; all state belongs to the instance."""

    def update(self, detections: Detections, time_s: float, image: Image | None) -> Tracks:
        """The confirmed tracks at `time_s`, which must grow from call to call; `image` is (H, W, 3) BGR or None.

        Raises:
            ValueError: time does not go forward.
        """
        ...


@runtime_checkable
class RefinableTracker(Tracker, Protocol):
    """Optional: a tracker with more to give to `track_range.tracking.offline_refinement`.

    The tracks of a tracker without these are refined too: no track gets its tentative start, none is dropped for its
    scores.
    """

    @property
    def tentative(self) -> Tracks:
        """The tracks detected in the last frame that are not confirmed yet; some will be, others never."""
        ...

    def track_activation_threshold(self, class_id: IntArray) -> FloatArray:
        """(N,) the score from which on boxes of these classes (N,) start tracks."""
        ...


class AppearanceModel(Protocol):
    """Computes appearance embeddings of boxes: vectors of length 1 whose cosine distance is small for one object.

    Attributes:
        max_cosine_distance: cosine distance up to which two embeddings are taken for one object's.
        notes: sentences for the user.
    """

    max_cosine_distance: float
    notes: tuple[str, ...]

    def embed(self, image: Image, xyxy_px: FloatArray) -> Descriptors:
        """(N, D) embeddings of length 1 of the boxes (N, 4) in `image`, (H, W, 3) uint8 BGR; zeros = unknown."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerOptions:
    """What the program hands to every new tracker.

    Attributes:
        reid: the user's re-identification network (`--reid`); None = the tracker's own appearance model, if it has one.
    """

    reid: AppearanceModel | None = None
