"""The tracks of a frame, confirmed or not, with the tracker's errors."""

from track_range.detection.detections import Detections
from track_range.foundation.errors import named_errors
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.registry import (
    ObjectTracker,
    TrackerError,
    checked_tracks,
    tracker_class,
)
from track_range.tracking.tracks import Tracks


def tracked(tracker: ObjectTracker, detections: Detections, frame: Frame) -> Tracks:
    """Tracks of the frame; TrackerError names a tracker of another package and the frame at which
    it failed.
    """
    kind = tracker_class(tracker)
    where = f"{kind.__module__}:{kind.__qualname__}, frame {frame.index}"
    with named_errors(kind.__module__, where, TrackerError):
        return checked_tracks(tracker, tracker.update(detections, frame.time_s, frame.left))


def unconfirmed(tracker: ObjectTracker) -> Tracks:
    """The boxes of the last frame whose tracks are not confirmed yet; none of a tracker that does
    not tell.
    """
    tentative = getattr(tracker, "tentative", None)
    return tentative if isinstance(tentative, Tracks) else Tracks.empty()
