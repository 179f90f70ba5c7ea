"""Trackers by name: built-in trackers, trackers of installed packages, and any class as
`package.module:Class`.

A tracker needs one file, with a class that has `update`
(`track_range.tracking.registry.ObjectTracker`) and takes `TrackerOptions`, and one registration: a
line in `TRACKERS`, an entry point of the group `track_range.trackers` in another package, or a call
to `register_tracker`.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.classes import ROAD_CLASS_TABLE, ROAD_CLASSES
from track_range.detection.detections import Descriptors, Detections
from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import quoted
from track_range.foundation.processes import search_current_folder
from track_range.foundation.registry import Registry, imported
from track_range.foundation.sparse_flow import BackgroundFlow
from track_range.tracking.tracks import Tracks


@runtime_checkable
class ObjectTracker(Protocol):
    """Assigns identities to the boxes of successive frames; all state belongs to the instance."""

    def update(self, detections: Detections, time_s: float, image: Image | None) -> Tracks:
        """The confirmed tracks at `time_s`, which must increase from call to call; `image` is (H,
        W, 3) BGR or None.

        The detections are all boxes with a score from `--min-score` on (0.1), as trackers with two
        thresholds need them, unless the tracker has a `min_score`.

        Raises ValueError: `time_s` is not later than in the previous call.
        """
        ...


@runtime_checkable
class RefinableTracker(ObjectTracker, Protocol):
    """A tracker with additional output for `track_range.tracking.offline_refinement`; optional.

    The tracks of other trackers are refined too, but without the boxes before a track's
    confirmation, and tracks with low scores are not dropped.
    """

    @property
    def tentative(self) -> Tracks:
        """The tracks detected in the last frame that are not confirmed yet."""
        ...

    def track_activation_threshold(self, class_id: IntArray) -> FloatArray:
        """(N,) minimum score at which a detection of a class (N,) starts a track."""
        ...


class AppearanceModel(Protocol):
    """Computes appearance embeddings of boxes: vectors of length 1 with small cosine distances for
    one object.
    """

    max_cosine_distance: float  # largest one between two embeddings of one object
    notes: tuple[str, ...]  # for the user

    def embed(self, image: Image, xyxy_px: FloatArray) -> Descriptors:
        """(N, D) unit-norm embeddings of the boxes (N, 4) in `image`, (H, W, 3) uint8 BGR; zeros =
        unknown.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerOptions:
    """Options that the program passes to every new tracker."""

    # network of `--reid`; None = the tracker's default appearance model, if any
    reid: AppearanceModel | None = None
    flow: BackgroundFlow | None = None  # shared with the odometry of the run; None = none to share
    # whether boxes may be smoothed over time: not where distances are measured on them
    is_smoothed: bool = False
    # smallest score of the detections that a tracker gets; None = as it is registered
    min_score: float | None = None


TrackerFactory = Callable[[TrackerOptions], ObjectTracker]  # class or function that makes a tracker


class TrackerError(UserError):
    """A tracker that is unknown or unusable, or that returned wrong results; the message is one
    sentence.
    """


@dataclass(frozen=True, slots=True)
class RegisteredTracker:
    """A tracker that `--tracker` can select."""

    # makes the tracker; a string "package.module:attribute" is imported on first use
    factory: TrackerFactory | str
    uses_reid: bool = False  # whether it uses `TrackerOptions.reid`
    min_score: float = 0.0  # smallest score of the detections that it gets; 0 = all


TRACKERS: Registry[RegisteredTracker] = Registry(
    "track_range.trackers",
    {
        "road": RegisteredTracker("track_range.tracking.deepsort:road", uses_reid=True),
        "deepsort": RegisteredTracker("track_range.tracking.deepsort:deepsort", uses_reid=True),
        "sort": RegisteredTracker("track_range.tracking.deepsort:sort"),
    },
)


def register_tracker(
    name: str,
    factory: TrackerFactory | str,
    *,
    uses_reid: bool = False,
    min_score: float = 0.0,
) -> None:
    """Make a tracker available as `--tracker NAME`; see `RegisteredTracker` for the arguments.

    Raises TrackerError: another tracker has this name; ValueError: the name is empty or contains a
    colon.
    """
    if not name or ":" in name:
        raise ValueError(f"{name!r}: expected a tracker's name without a colon")
    if name in TRACKERS.names:
        raise TrackerError(f"tracker name '{name}': already in use; choose another name.")
    TRACKERS.registered[name] = RegisteredTracker(factory, uses_reid=uses_reid, min_score=min_score)


def find_tracker(name: str) -> RegisteredTracker:
    """The tracker with a name or `package.module:Class`, checked as far as possible without
    creating a tracker.

    The command line also searches for a `package.module:Class` in the current folder, after the
    installed modules. Raises TrackerError: there is no such tracker, or it does not take
    `TrackerOptions`.
    """
    listed = TRACKERS.find(name)
    if isinstance(listed, RegisteredTracker):
        return listed
    if listed is None and ":" not in name:
        known = ", ".join(TRACKERS.names)
        raise TrackerError(
            f"unknown tracker {quoted(name)}: expected {known}, or package.module:Class."
        )
    if listed is None:
        search_current_folder()
    factory = _imported(listed or name, TRACKERS.origin(name) or name)
    try:
        inspect.signature(factory).bind(TrackerOptions())
    except (TypeError, ValueError) as error:
        raise TrackerError(
            f"{name}: expected a class or function with one argument, the TrackerOptions."
        ) from error
    return RegisteredTracker(
        factory,
        uses_reid=bool(getattr(factory, "uses_reid", False)),
        min_score=float(getattr(factory, "min_score", 0.0)),
    )


def create_tracker(name: str, options: TrackerOptions | None = None) -> ObjectTracker:
    """A new tracker without tracks.

    `name`: one of `TRACKERS.names`, or `package.module:Class`; `options`: None = the defaults.

    Raises TrackerError: the name is unknown, the tracker does not take `TrackerOptions`, or it has
    no method `update`.
    """
    listed, options = find_tracker(name), options or TrackerOptions()
    factory = _imported(listed.factory, name)
    try:
        tracker = factory(options)
    except TypeError as error:
        raise TrackerError(f"{name}: cannot be created from TrackerOptions ({error}).") from error
    if not callable(getattr(tracker, "update", None)):
        raise TrackerError(
            f"{name}: expected a method update(detections, time_s, image), found none."
        )
    min_score = listed.min_score if options.min_score is None else options.min_score
    return ThresholdedTracker(tracker, min_score) if min_score > 0 else tracker


class ThresholdedTracker:
    """A tracker that gets only the detections with a score of at least `min_score`."""

    def __init__(self, tracker: ObjectTracker, min_score: float) -> None:
        """Wrap a tracker."""
        self.tracker, self.min_score = tracker, min_score

    def update(self, detections: Detections, time_s: float, image: Image | None) -> Tracks:
        """See `ObjectTracker`."""
        confident = detections.select(detections.score >= self.min_score)
        return self.tracker.update(confident, time_s, image)

    def __getattr__(self, name: str) -> Any:
        """The other attributes of the tracker; none before a copy or a stored state has one."""
        if name == "tracker":
            raise AttributeError(name)
        return getattr(self.tracker, name)


def tracker_class(tracker: ObjectTracker) -> type:
    """The class of a tracker, also of a thresholded one."""
    return type(tracker.tracker if isinstance(tracker, ThresholdedTracker) else tracker)


def checked_tracks(tracker: ObjectTracker, result: Any) -> Tracks:
    """The result of a tracker's `update`; TrackerError: it is not `Tracks`, or has invalid classes,
    ids or boxes.
    """
    kind = tracker_class(tracker)
    name = f"{kind.__module__}:{kind.__qualname__}"
    if not isinstance(result, Tracks):
        raise TrackerError(
            f"{name}: expected Tracks from the tracker's update, got {type(result).__name__}."
        )
    class_id = result.class_id
    if (
        class_id.dtype.kind not in "iu"
        or not ((class_id >= 0) & (class_id < len(ROAD_CLASSES))).all()
    ):
        raise TrackerError(
            f"{name}: expected class_id among {ROAD_CLASS_TABLE}, got {class_id.tolist()}."
        )
    if not name.startswith("track_range."):
        if len(np.unique(result.track_id[result.track_id >= 0])) < len(result):
            raise TrackerError(
                f"{name}: expected track_id >= 0, each once per frame, got "
                f"{result.track_id.tolist()}."
            )
        if not (is_valid := are_valid_boxes(result.xyxy_px)).all():
            box = result.xyxy_px[~is_valid][0].tolist()
            raise TrackerError(
                f"{name}: expected xyxy_px with finite x1 < x2 and y1 < y2, got {box}."
            )
    return result


def _imported(factory: TrackerFactory | str, origin: str) -> TrackerFactory:
    """The class or function, imported if it is given as "package.module:attribute"; TrackerError
    with its origin if that fails.
    """
    try:
        made_by = imported(factory)
    # a module of another package may raise anything
    except Exception as error:
        raise TrackerError(f"{origin}: cannot be imported as a tracker ({error}).") from error
    if not callable(made_by):
        raise TrackerError(
            f"{origin}: expected a class or function, found {type(made_by).__name__}."
        )
    return made_by
