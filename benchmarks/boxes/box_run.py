"""Runs of the pipeline on drives without images: tracker, size ranging, fusion, filters, warnings
and events.

The tracker gets boxes with embeddings and the camera's rotation, as if estimated from images.
Methods that need only boxes measure as they do in a run; stereo distances come from the drive.
Several drives in the same scene with different errors run as one, with different track ids, since
the later stages take hardly longer for many tracks than for few.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from benchmarks.boxes.box_drive import BoxDrive, BoxFrame
from track_range.detection.boxes import iou
from track_range.detection.detections import Detections
from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.pipeline.alarming import AlarmStage
from track_range.pipeline.clock import StageClock
from track_range.pipeline.detecting import Detected, DetectionStage
from track_range.pipeline.doubting import DoubtStage
from track_range.pipeline.ego import EgoStage
from track_range.pipeline.filtering import FilterStage
from track_range.pipeline.frame_pipeline import FramePipeline
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.ranging import RangingStage
from track_range.pipeline.world import WorldStage
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import MethodContext, Ranger
from track_range.ranging.methods.patch_stereo import STEREO
from track_range.ranging.methods.size_regression import MONO
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.image_motion import ImageMotion, ImageMotionEstimator
from track_range.stereo.speed.ego_speed import EgoSpeed
from track_range.tracking.appearance.embeddings import ColourLayoutSettings
from track_range.tracking.camera_motion import CameraMotion
from track_range.tracking.deepsort import AppearanceSettings, DeepSortSettings, DeepSortTracker
from track_range.tracking.tracks import Tracks

MIN_IOU = 0.5  # smallest IoU of a track's box with the box of the drive that it was updated with
# standard deviation of the yaw rate, rad/s: that of image motion on rendered drives
YAW_SIGMA_RAD_S = 0.004
IDS_PER_DRIVE = 100_000  # difference between the track ids of two drives that run as one
SIZE_MODEL = load_curves()

Step = tuple[BoxFrame, Tracks, Tracks]  # a frame of a drive, its tracks and tentative tracks


@dataclass(frozen=True, slots=True)
class BoxResult:
    """Result of the pipeline for one frame of K drives; the drive of a track is its id //
    `IDS_PER_DRIVE`.

    `user` (N,) is the row of the scene's road users of each track, -1 = a false box, or predicted
    only; `true_m` (N,) its distance, NaN without a road user.
    """

    result: FrameResult
    user: IntArray
    true_m: FloatArray


def tracked(drive: BoxDrive) -> list[Step]:
    """The frames of a drive with their tracks, by the default tracker."""
    tracker = _BoxTracker()
    image = _no_image(drive.rig.left)
    return [(frame, tracker.update_frame(frame, image), tracker.tentative) for frame in drive]


def run_boxes(
    drives: Sequence[BoxDrive],
    tracks: Sequence[Sequence[Step]],
    *,
    methods: Sequence[str] = ("mono", "stereo"),
    warning: CollisionWarning | None = None,
) -> Iterator[BoxResult]:
    """Results of the pipeline for each frame of K drives in the same scene, with the result of
    `tracked` for each.

    The ranging methods are "mono", "stereo" or both.
    """
    drive = drives[0]
    camera, times_s = drive.rig.left, drive.times_s
    context = MethodContext(camera=camera, rig=drive.rig, size_model=SIZE_MODEL, has_images=False)
    source = _Source()
    rangers: dict[str, Ranger] = {}
    if "mono" in methods:
        sizes = [ranger for _ in drives if (ranger := MONO.create(context)) is not None]
        rangers[MONO.name] = _Sizes(source, sizes)
    if "stereo" in methods:
        rangers[STEREO.name] = source
    speeds_mps = np.array([drive.scene.speed_mps(time_s) for time_s in times_s.tolist()])
    pipeline = FramePipeline(
        detection=DetectionStage(detect=lambda frame: Detections.empty()),
        tracker=source,
        ego=EgoStage(
            speed=EgoSpeed(times_s, speeds_mps, "simulation"), image_motion=_TrueYaw(camera, drive)
        ),
        ranging=RangingStage(rangers),
        doubting=DoubtStage(),
        filtering=FilterStage(camera),
        world=WorldStage(camera),
        alarming=AlarmStage(camera, warning or CollisionWarning()),
        clock=NoClock(),
    )
    image = _no_image(camera)
    for steps in zip(*tracks, strict=True):
        source.set(steps)
        frame = steps[0][0]
        result = pipeline.step(
            Detected(Frame(frame.index, frame.time_s, image, None), None, frame.detections)
        )
        yield BoxResult(result, *source.truth())


def _no_image(camera: PinholeCamera) -> Image:
    """A black image that takes no memory."""
    return np.broadcast_to(np.zeros(3, np.uint8), (camera.height_px, camera.width_px, 3))


class _Shift(CameraMotion):
    """The image motion (2,) of the current frame of a drive."""

    def __init__(self) -> None:
        super().__init__()
        self.shift_px = np.zeros(2)

    def update(self, image: Image, xyxy_px: FloatArray, time_s: float = math.nan) -> FloatArray:
        """(2, 3) `now_from_before`."""
        return np.column_stack([np.eye(2), self.shift_px])


class _BoxTracker(DeepSortTracker):
    def __init__(self) -> None:
        gate = AppearanceSettings(max_cosine_distance=ColourLayoutSettings().max_cosine_distance)
        self._shift = _Shift()
        super().__init__(DeepSortSettings(appearance=gate), camera_motion=self._shift)

    def update_frame(self, frame: BoxFrame, image: Image) -> Tracks:
        self._shift.shift_px = frame.shift_px
        return self.update(frame.detections, frame.time_s, image)


class NoClock(StageClock):
    """Measures nothing: reading the clock takes longer than most stages."""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Do nothing."""
        yield


class _TrueYaw(ImageMotionEstimator):
    """The true yaw rate of the camera, with noise."""

    def __init__(self, camera: PinholeCamera, drive: BoxDrive) -> None:
        super().__init__(camera)
        self._times_s = drive.times_s
        yaw_rad = drive.poses.yaw_rad
        noise = np.random.default_rng([drive.scene.seed, 32]).normal(
            0, YAW_SIGMA_RAD_S, len(yaw_rad)
        )
        self._yaw_rad_s = np.gradient(yaw_rad, drive.times_s) + noise

    def update(self, image: Image, time_s: float, xyxy_px: FloatArray | None = None) -> ImageMotion:
        """The motion at a time of the drive."""
        yaw_rad_s = float(np.interp(time_s, self._times_s, self._yaw_rad_s))
        return ImageMotion(time_s=time_s, yaw_rad_s=yaw_rad_s, yaw_sigma_rad_s=YAW_SIGMA_RAD_S)


class _Source(Ranger):
    """Tracker and stereo ranger that return what the drives have for the current frame."""

    tracks: Tracks
    tentative: Tracks
    steps: Sequence[Step]

    def set(self, steps: Sequence[Step]) -> None:
        self.steps = steps
        self._box: list[IntArray] = []
        for frame, tracks, _ in steps:
            overlap = iou(tracks.xyxy_px, frame.detections.xyxy_px)
            box = overlap.argmax(axis=1) if overlap.shape[1] else np.zeros(len(tracks), np.int64)
            has_box = tracks.observed & (overlap.max(axis=1, initial=0.0) >= MIN_IOU)
            self._box.append(np.where(has_box, box, -1))
        self.tracks = _joined([tracks for _, tracks, _ in steps])
        self.tentative = _joined([tentative for _, _, tentative in steps])

    def track_activation_threshold(self, class_id: IntArray) -> FloatArray:
        """0 for all classes (N,): which boxes start tracks is decided before."""
        return np.zeros(len(class_id))

    def update(self, detections: Detections, time_s: float, image: Image | None) -> Tracks:
        """The tracks of the current frame."""
        return self.tracks

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        distance_m = self._of_boxes([frame.stereo_m for frame, *_ in self.steps])
        return Ranges(
            tracks.track_id,
            distance_m,
            self._of_boxes([frame.stereo_sigma_m for frame, *_ in self.steps]),
        )

    def truth(self) -> tuple[IntArray, FloatArray]:
        """Road user and true distance of the tracks."""
        user = self._of_boxes([frame.user.astype(np.float64) for frame, *_ in self.steps])
        true_m = self._of_boxes([frame.true_m for frame, *_ in self.steps])
        is_user = user >= 0  # false for NaN
        return np.where(is_user, user, -1).astype(np.int64), np.where(is_user, true_m, np.nan)

    def _of_boxes(self, values: Sequence[FloatArray]) -> FloatArray:
        """(N,) values of the tracks' boxes; NaN = none."""
        return np.concatenate(
            # -1 = the NaN
            [np.append(value, np.nan)[box] for value, box in zip(values, self._box, strict=True)]
        )


def _joined(drives: Sequence[Tracks]) -> Tracks:
    """The tracks of K drives as those of one."""
    columns = [
        np.concatenate([getattr(tracks, name) for tracks in drives]) for name in Tracks.__slots__
    ]
    first_id = np.repeat(IDS_PER_DRIVE * np.arange(len(drives)), [len(part) for part in drives])
    return Tracks(columns[0] + first_id, *columns[1:])


class _Sizes(Ranger):
    """Size ranging of each drive separately, since the boxes of a frame share the ground."""

    def __init__(self, source: _Source, rangers: Sequence[Ranger]) -> None:
        self._source, self._rangers = source, rangers

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        parts = [
            ranger.measure(own, frame)
            for ranger, (_, own, _) in zip(self._rangers, self._source.steps, strict=True)
        ]
        distance_m, sigma_m = np.concatenate(
            [[part.distance_m, part.sigma_m] for part in parts], axis=1
        )
        systematic_m = [part.sigma_systematic_m for part in parts]
        unknown = [np.full(len(part), np.nan) for part in parts]
        known = [
            nan if values is None else values
            for nan, values in zip(unknown, systematic_m, strict=True)
        ]
        return Ranges(tracks.track_id, distance_m, sigma_m, np.concatenate(known))
