"""RangingMethod: description of one way to measure distance.

A method is one file with a `Ranger` and one `RangingMethod` that describes it, registered in
`ranging.registry`.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, get_args

import numpy as np

from track_range.detection.box_errors import BoxErrors
from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.errors import UserError
from track_range.ranging.measurement.dense_map import DenseMap
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.size_models.drive_scale import DriveScale, ScaleEvidence
from track_range.ranging.size_models.network_scale import NetworkDistances
from track_range.ranging.size_models.region import Region
from track_range.ranging.size_models.size_model import BoxTraits, SizeModel
from track_range.ranging.world.road_plane import RoadPlane
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.odometry.ego_motion import CameraStep
from track_range.stereo.odometry.road_horizon import RoadView
from track_range.tracking.tracks import Tracks

if TYPE_CHECKING:  # onnxruntime takes long to import, and reports do without it
    from track_range.detection.models.onnx_session import Runtime

SourceName = Literal[
    "size",
    "box_height",
    "contact_point",
    "horizon",
    "baseline",
    "lane_width",
    "drive_scale",
    "network",
    "own",
]
"""Sources of distance errors.

size: deviation of the object's size from the mean of its class; box_height: height of the box in
the image; contact_point: row where the object touches the ground; horizon: pitch of the camera and
slope of the road; baseline: geometry of the stereo rig; lane_width: width of the lane; drive_scale:
error of all distances by size of a drive; network:
what depth networks have in common; own: errors that no other method shares.
"""

Requirement = Literal[
    "image",
    "rig",
    "right_image",
    "dense_disparity",
    "lane_lines",
    "camera_height",
    "recorded_depth",
]
"""Inputs that a method may require.

image: pixels of the left image, not only boxes; rig: a calibrated stereo pair; right_image: a
row-aligned stereo pair, calibrated or not; dense_disparity: dense stereo is enabled; lane_lines:
lane detection is enabled; camera_height: the height of the camera above the road is given;
recorded_depth: frames have depths that the camera recorded.
"""

# names of the stages of a run before and after the methods, which are stages, too
FIRST_STAGES = ("read", "lanes", "detect", "track", "ego")
LAST_STAGES = ("doubt", "fuse", "filter", "world", "alarm", "write")
RESERVED_NAMES = (*FIRST_STAGES, *LAST_STAGES, "fused", "x", "y", "truth", "scored_truth")
"""Names of result columns and pipeline stages, which a method cannot have."""


class MethodError(UserError):
    """A ranging method that cannot be used; the message names the method and the reason."""


class Measured(NamedTuple):
    """Distances of one method in a frame, and their evidence of the scale of the drive, if any."""

    ranges: Ranges
    evidence: ScaleEvidence | None = None
    by_network: NetworkDistances | None = None  # before their correction


class OpenedNetwork(Protocol):
    """A network that a ranger measures with.

    Attributes:
        path: its ONNX file.
        notes: messages for the user, one sentence each.
        described: how the file is understood, as JSON values by key, for summary.json.
    """

    @property
    def path(self) -> Path:
        """See the class."""
        ...

    @property
    def notes(self) -> Sequence[str]:
        """See the class."""
        ...

    @property
    def described(self) -> Mapping[str, Any]:
        """See the class."""
        ...


class Ranger(ABC):
    """Measures the distance of each track of a frame; an implementation may have state per track
    id.

    Only `measure` is required. The other members are hooks that a run calls or reads; their
    defaults do nothing. For each frame a run calls `start` (in another thread, up to a few frames
    ahead), `update_road` and `update_motion` if the images show the road and the motion of the
    camera, `update_lanes` if lanes were detected in the frame, and `measure_at_scale`, which by
    default calls `measure_with`; of an image that only repeats the one before it, it calls `start`
    and `skip`. After the last frame it calls `close`.

    Attributes:
        background_s: seconds of work so far in the ranger's own threads; a run adds them to the
            time of its stage.
        dense: depths or disparities of all pixels of the frame measured last, for the overlay and
            the files of depth; None = the method computes none.
        network: the network that it measures with, if any. A stored state of a pipeline does not
            contain it, and a run adds its notes to those of the method.
    """

    background_s: float = 0.0
    dense: DenseMap | None = None
    network: OpenedNetwork | None = None

    @abstractmethod
    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of N tracks in the same order, NaN = not measured."""

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """Distances of N tracks, given their ranges in the same frame by the methods measured
        before.

        `others` are ranges by method name, of the methods in `RangingMethod.reads` that are part of
        this run.
        """
        return self.measure(tracks, frame)

    def measure_at_scale(
        self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges], scale: DriveScale
    ) -> Measured:
        """See `measure_with`; given the scale of the drive before this frame, also returns the
        evidence of the frame.

        It is for methods that measure by size or measure the scale.
        """
        return Measured(self.measure_with(tracks, frame, others))

    def start(self, frame: Frame) -> None:  # noqa: B027
        """Start work on a frame in the background, before its tracks are known; `measure` or `skip`
        of the frame follows.
        """

    def skip(self, frame: Frame) -> None:  # noqa: B027
        """Drop the work that `start` began: the frame is not measured."""

    def update_lanes(self, lines: LaneLines) -> None:  # noqa: B027
        """Store newly detected lines of the ego lane; called a few times per second, valid until
        the next call.
        """

    def update_road(self, road: RoadView) -> None:  # noqa: B027
        """Store the road in the frame that is measured next, from image motion; lengths in
        metres.
        """

    def update_motion(self, step: CameraStep) -> None:  # noqa: B027
        """Store the motion of the camera to the frame that is measured next; not called where it is
        unknown.
        """

    def close(self) -> None:  # noqa: B027
        """Stop threads and release resources; no measurement follows."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user at the end of a run, one sentence each."""
        return ()

    def summary(self) -> dict[str, Any]:
        """Entries for the top level of summary.json: JSON values under unique keys."""
        return {}


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodContext:
    """Inputs from which the rangers of a run, or of an evaluation of boxes, are created.

    Attributes:
        camera: the (left) camera, undistorted.
        rig: the rectified pair, of which a pair without a calibration has an assumed baseline
            (`StereoRig.is_assumed`): what has the scale of the rig (`RangingMethod.has_rig_scale`)
            is corrected after the measurement; None = one camera.
        focal_sigma: relative sigma of the focal length, which all methods share; 0 = calibrated.
        size_model: sizes of road users; None = the packaged model.
        box_sigma_px: sigma of one box edge; None = the noise model of a detector (`BoxNoise`).
        box_errors: systematic errors of the detector's boxes; None = unknown, or none with
            `box_sigma_px`.
        camera_height_m: height of the camera above the road; None = unknown.
        region: region of the recording.
        lane_width_m: distance between the centre lines of the lane markings; None = not given.
        road_plane: the plane of the road before a camera that stands still; None = unknown. Then only
            methods that use it run, and those of a pair.
        has_images: whether frames have pixels; False if only boxes are evaluated.
        has_visible_boxes: whether boxes end where a nearer object begins, as the boxes of a
            detector do.
        has_lane_lines: whether lane lines are detected.
        has_dense_disparity: whether dense stereo runs.
        has_recorded_depth: whether frames have depths that the camera recorded.
        sgbm_options: parameters of dense stereo set by the user.
        runtime: threads and device for networks; None = the defaults.
        depth_models: ONNX files of depth networks, by the name of their method.
        stereo_models: ONNX files of stereo networks, by the name of their method.
        rangers: created so far, by name; first those in `reads`.
    """

    camera: PinholeCamera
    rig: StereoRig | None = None
    focal_sigma: float = 0.0
    size_model: SizeModel | None = None
    box_sigma_px: float | None = None
    box_errors: BoxErrors | None = None
    camera_height_m: float | None = None
    region: Region = "unknown"
    lane_width_m: float | None = None
    has_images: bool = True
    road_plane: RoadPlane | None = None
    has_visible_boxes: bool = False
    has_lane_lines: bool = False
    has_dense_disparity: bool = False
    has_recorded_depth: bool = False
    sgbm_options: Mapping[str, Any] = field(default_factory=dict)
    runtime: Runtime | None = None
    depth_models: Mapping[str, Path] = field(default_factory=dict)
    stereo_models: Mapping[str, Path] = field(default_factory=dict)
    rangers: Mapping[str, Ranger] = field(default_factory=dict)

    @property
    def alignment(self) -> Alignment:
        """Correction of the rig's disparities in frames that hold none; `rig.alignment_of(frame)` is
        that of any frame.
        """
        known = None if self.rig is None else self.rig.alignment
        return known or Alignment()

    @property
    def traits(self) -> BoxTraits:
        """Errors of the boxes."""
        return BoxTraits.of(
            self.camera.width_px,
            box_sigma_px=self.box_sigma_px,
            errors=self.box_errors,
            are_visible=self.has_visible_boxes,
        )

    @property
    def available(self) -> frozenset[Requirement]:
        """Requirements that this context meets."""
        is_met: dict[Requirement, bool] = {
            "image": self.has_images,
            "rig": self.rig is not None and not self.rig.is_assumed,
            "right_image": self.rig is not None,
            "dense_disparity": self.has_dense_disparity,
            "lane_lines": self.has_lane_lines,
            "camera_height": self.camera_height_m is not None,
            "recorded_depth": self.has_recorded_depth,
        }
        return frozenset(name for name, met in is_met.items() if met)


@dataclass(frozen=True, slots=True)
class ErrorSource:
    """Contribution of one error source to a method's variance.

    Attributes:
        name: the source; methods that declare the same source share its error.
        systematic: fraction of the variance, 0..1, that is constant over a track.
        independent: fraction of the variance, 0..1, that is independent from frame to frame.
    """

    name: SourceName
    systematic: float = 0.0
    independent: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RangingMethod:
    """One way to measure distance.

    Attributes:
        name: prefix of its columns: `NAME_m`, `NAME_sigma_m`.
        title: short noun phrase for the legend of the overlay.
        letter: one letter for the labels of the overlay.
        colour: "#rrggbb" in charts and in the overlay.
        create: creates the method's `Ranger` for a run, or returns None if the run does not support
            the method.
        needs: required inputs; `create` is called only if the run has all of them.
        reads: names of methods whose ranges this method uses if they are part of the run; they
            measure a frame first.
        error_sources: the contributions to its variance; their fractions sum to 1.
        fallback_for: name of a method that supersedes this one: fusion uses this method only for
            tracks that the other method has not measured, since it shares nearly all errors of the
            other method or is calibrated by it.
        is_scale_reference: whether fusion takes the scale of this method as correct: its systematic
            error is part of the covariance, but is not estimated from differences to other methods.
        measures_distance: False for a method that gives details or growths only; it has no error
            sources.
        uses_road_plane: whether it measures with the known plane of the road before a camera that
            stands still.
        fuses: False for a method that is only shown beside the others: its distances, and what it
            shows of the scale of the drive, are not part of `fused`.
        is_optional: whether it measures only in runs that ask for it, by an option or by what they
            record, so that only their files have its columns.
        is_filtered: whether it also has a filter over time (`NAME_kf_m`).
        details: names of further values of each track, in `Ranges.details`, perhaps with their
            meanings for the documentation; their columns are NAME_DETAIL.
    """

    name: str
    title: str
    letter: str
    colour: str
    create: Callable[[MethodContext], Ranger | None]
    error_sources: tuple[ErrorSource, ...]
    needs: frozenset[Requirement] = frozenset()
    reads: tuple[str, ...] = ()
    fallback_for: str | None = None
    is_scale_reference: bool = False
    measures_distance: bool = True
    fuses: bool = True
    is_optional: bool = False
    is_filtered: bool = False
    uses_road_plane: bool = False
    details: Mapping[str, str] | tuple[str, ...] = field(default=(), hash=False)

    def __post_init__(self) -> None:
        for field_name, as_collection in (
            ("needs", frozenset),
            ("reads", tuple),
            ("details", dict if isinstance(self.details, Mapping) else tuple),
        ):
            names = getattr(self, field_name)
            is_list = isinstance(names, Collection) and not isinstance(names, str)
            if not is_list or not all(isinstance(name, str) for name in names):
                raise MethodError(
                    f"ranging method {self.name!r}: expected {field_name} as a tuple of names, got "
                    f"{names!r}"
                )
            object.__setattr__(self, field_name, as_collection(names))
        sources, needs = get_args(SourceName), get_args(Requirement)
        parts = [
            part
            for source in self.error_sources
            for part in (source.systematic, source.independent)
        ]
        columns = [re.fullmatch(r"[a-z][a-z0-9_]*(?<!_m)", name) for name in self.details]
        is_met = {
            "expected a lower-case name for columns": re.fullmatch(r"[a-z][a-z0-9_-]*", self.name),
            "expected a name that does not end with _kf or _sigma": not self.name.endswith(
                ("_kf", "_sigma")
            ),
            f"expected a name that is not reserved ({', '.join(RESERVED_NAMES)})": self.name
            not in RESERVED_NAMES,
            f"expected one letter, got {self.letter!r}": len(self.letter) == 1
            and self.letter.isprintable(),
            f"expected a colour as #rrggbb, got {self.colour!r}": re.fullmatch(
                r"#[0-9a-f]{6}", self.colour
            ),
            "expected lower-case details for columns, without the ending _m": all(columns),
            "expected reads and fallback_for to name other methods": self.name
            not in (*self.reads, self.fallback_for),
            f"expected needs among {', '.join(needs)}, got {', '.join(self.needs)}": self.needs
            <= set(needs),
            f"expected error sources among {', '.join(sources)}": {
                s.name for s in self.error_sources
            }
            <= set(sources),
            f"expected non-negative error sources that sum to 1, got a sum of {sum(parts):.4f}": (
                math.isclose(sum(parts), float(self.measures_distance), abs_tol=1e-6)
                and min(parts, default=0) >= 0
            ),
        }
        for expected, holds in is_met.items():
            if not holds:
                raise MethodError(f"ranging method {self.name!r}: {expected}")

    @property
    def has_rig_scale(self) -> bool:
        """Whether its distances have the scale of the rig, which an error of the baseline
        changes.
        """
        return any(source.name == "baseline" for source in self.error_sources)

    @property
    def uses_size_model(self) -> bool:
        """Whether the method has object size as an error source; `evaluate ranges` then refits its
        size model.
        """
        return any(source.name == "size" for source in self.error_sources)

    @property
    def noise_share(self) -> float:
        """Fraction of sigma (not of the variance) that is independent from frame to frame, 0..1."""
        return math.sqrt(sum(source.independent for source in self.error_sources))


def checked_ranges(
    method: str, ranges: Any, tracks: Tracks, n_invalid: Counter[tuple[str, str]] | None = None
) -> Ranges:
    """Ranges of the tracks as a ranger of this method returned them, for fusion and filters.

    A track with a distance or sigma that is not finite and positive counts as not measured: both
    become NaN, and `n_invalid` by method and column rises. Raises MethodError: `ranges` is not a
    `Ranges`, or has other tracks.
    """
    if not isinstance(ranges, Ranges):
        raise MethodError(
            f"ranging method {method!r}: expected Ranges, got {type(ranges).__name__}"
        )
    if len(ranges) != len(tracks):
        raise MethodError(
            f"ranging method {method!r}: expected {len(tracks)} ranges, got {len(ranges)}"
        )
    if ranges.track_id is not tracks.track_id and not np.array_equal(
        ranges.track_id, tracks.track_id
    ):
        raise MethodError(
            f"ranging method {method!r}: expected the track_id of the tracks in the same order"
        )
    distance_m, sigma_m, systematic_m = ranges.distance_m, ranges.sigma_m, ranges.sigma_systematic_m
    # False for NaN: the smaller of two values is positive only if both are
    is_measured = np.minimum(distance_m, sigma_m) > 0
    is_measured &= np.maximum(distance_m, sigma_m) < np.inf
    if systematic_m is not None:
        is_measured &= (systematic_m >= 0) & (systematic_m < np.inf)
    is_empty = np.isnan(distance_m) & np.isnan(sigma_m)
    if np.count_nonzero(is_measured) + np.count_nonzero(is_empty) == len(ranges):
        return ranges
    if n_invalid is not None:
        _count_invalid(method, ranges, n_invalid)
    if systematic_m is not None:
        systematic_m = np.where(is_measured, systematic_m, np.nan)
    return ranges.with_distances(
        np.where(is_measured, distance_m, np.nan),
        np.where(is_measured, sigma_m, np.nan),
        systematic_m,
    )


def _count_invalid(method: str, ranges: Ranges, n_invalid: Counter[tuple[str, str]]) -> None:
    """Count the given distances that are not valid, each by its first column that is not."""
    distance_m, sigma_m, systematic_m = ranges.distance_m, ranges.sigma_m, ranges.sigma_systematic_m
    is_valid = {
        "distance_m": (distance_m > 0) & (distance_m < np.inf),
        "sigma_m": (sigma_m > 0) & (sigma_m < np.inf),
    }
    if systematic_m is not None:
        is_valid["sigma_systematic_m"] = (systematic_m >= 0) & (systematic_m < np.inf)
    is_given = ~np.isnan(distance_m)
    for column, valid in is_valid.items():
        n_invalid[method, column] += int((is_given & ~valid).sum())
        is_given &= valid
