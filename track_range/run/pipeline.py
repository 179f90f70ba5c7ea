"""Pipeline: everything that a run does with a frame, for frames in memory, from a driver, a robot or a ROS node.

    check the images -> rectify -> FramePipeline.step -> rows and events -> alignment for the next frame

Nothing is read ahead, and no step waits for an estimate: the check of a pair, its alignment and a
focal length come from a process of low priority beside the steps (`foundation.background`), and are
used from the first frame after they are known. `deterministic=True` waits for them.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from numbers import Real
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, overload

import cv2
import numpy as np
from rich.console import Console

from track_range.detection.detector import ObjectDetector
from track_range.detection.fixed_parts import FixedParts
from track_range.foundation.arrays import Image
from track_range.foundation.background import Background, InThreads, beside_steps
from track_range.foundation.errors import ConfigError, UsageError
from track_range.foundation.schemas.keywords import KeywordsInErrors
from track_range.pipeline.frame_pipeline import FramePipeline
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.health import Health, health_of
from track_range.pipeline.state import PipelineState, StateError, check_version, dumped, loaded
from track_range.pipeline.throughput import latency_ms
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.world.ground_file import read_ground
from track_range.recording.cameras.auto_alignment import PairAlignment, given_alignment
from track_range.recording.cameras.calibration import (
    LensView,
    RecordingCalibration,
    calibration_of,
    names_of,
)
from track_range.recording.cameras.known_lenses import GivenLens
from track_range.recording.pairs.aligner import ONE_BY_ONE, PairAligner
from track_range.recording.video.frame import FrameError, RecordedFrame
from track_range.recording.video.pixel_formats import bgr_of, pixel_format_of
from track_range.recording.video.step_times import Moment, StepTimes
from track_range.results.events.event import Event
from track_range.results.events.finder import EventFinder
from track_range.results.table import RecentRows
from track_range.run.box_source import boxes_of, network_source, outside_regions
from track_range.run.build import open_pipeline, warm_up
from track_range.run.options.opened import open_detector
from track_range.run.options.opened_methods import check_networks
from track_range.run.options.python_keywords import options_and_objects, pipeline_options
from track_range.run.options.settings import NEEDS_PAIR, PipelineOptions, RunSettings
from track_range.run.ready_model import ready_model
from track_range.run.reports.visibility import Visibility
from track_range.stereo.alignment.file import load_alignment
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.geometry.rig_checks import check_camera
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.stereo.rig_formats.reading import content_of, load_calibration
from track_range.stereo.speed.ego_speed import MAX_SPEED_MPS, TABLE_SIGMA_MPS
from track_range.tracking.registry import ObjectTracker

if TYPE_CHECKING:
    from typing import Unpack

    import pyarrow as pa

    from track_range.run.option_types import PipelineKeywords

Cameras = str | Path | StereoRig | PinholeCamera  # a calibration file, or the models of the cameras


_MAX_BACKWARDS_MPS = 20.0  # largest plausible speed backwards; a faster one has the wrong sign
_N_LATENCIES = 1000  # latest frames of which the latency is stated
# largest difference between a frame's time and a clock of this machine that stamps the images
_SAME_CLOCK_S = 10.0
# time of frames after which the notes are looked at for `Pipeline.health`
_HEALTH_S = 1.0
_N_LOOKS = 10  # latest images of which the visibility is known, each of ten frames


@dataclass(frozen=True, slots=True)
class _Parts:
    """The parts of a pipeline that depend on the size of the images, as the first frame has it."""

    calibration: RecordingCalibration  # without an estimated alignment
    aligner: PairAligner | None  # None = one camera
    stages: FramePipeline

    def check_sizes(self, images: Mapping[str, Image]) -> None:
        """Raises FrameError if an image has another size than the first one."""
        for (name, image), size_px in zip(images.items(), self.calibration.sizes_px, strict=True):
            if (image.shape[1], image.shape[0]) != size_px:
                raise FrameError(
                    f"{name}: expected {size_px[0]}x{size_px[1]} px as before, found "
                    f"{image.shape[1]}x{image.shape[0]} px."
                )

    def step(self, recorded: RecordedFrame, known: EgoMotion | None) -> FrameResult:
        """The result of the next frame, without the estimate of the alignment from it."""
        if self.aligner is None:
            frame = self.calibration.rectified(recorded)
        else:
            (aligned,) = self.aligner.add(recorded)
            frame = aligned.frame
        return self.stages.step(self.stages.detected(frame), known)

    @property
    def current(self) -> RecordingCalibration:
        """The camera models of the next rectified frame."""
        return self.calibration if self.aligner is None else self.aligner.calibration

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user about the calibration, the pair and the stages so far."""
        stages = self.stages
        return (
            *self.current.notes,
            *(() if self.aligner is None else self.aligner.notes),
            *stages.notes(),
            *stages.ranging.notes(),
            *stages.doubting.notes(),
        )


@dataclass(slots=True)
class _Drive:
    """What a pipeline knows of its drive."""

    rows: RecentRows
    parts: _Parts | None = None  # None = before the first frame
    times: StepTimes = field(default_factory=StepTimes)
    n_frames: int = 0
    visibility: Visibility = field(default_factory=lambda: Visibility(_N_LOOKS))
    health: Health = field(default_factory=Health)
    time_s: float = 0.0  # of the last frame, and of the one at which the health was looked at
    checked_s: float = -_HEALTH_S


@dataclass(frozen=True, slots=True)
class _Cameras:
    """What is given of the cameras of a pipeline."""

    models: Path | StereoRig | PinholeCamera | float | None  # a number is a focal length
    view: LensView
    align: str | Path | Alignment | PairAlignment | None = "off"
    is_pair: bool = field(default=False, kw_only=True)
    # of the file: of the camera, or of the left and the right one; empty = the usual ones
    names: tuple[str, ...] = field(default=(), kw_only=True)
    # of the images, of a pair also one each; None = BGR or grey
    pixel_format: str | tuple[str, str] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        for name in _formats(self.pixel_format).values():
            if name is not None:
                pixel_format_of(name)


def _opened_alignment(
    align: str | Path | Alignment | PairAlignment | None,
) -> str | Alignment | PairAlignment:
    """An alignment, "auto" or "off"; a file is read."""
    if isinstance(align, str | Path) and align not in ("auto", "off"):
        return load_alignment(align)
    if align is None:
        return "auto"
    if isinstance(align, str | Alignment | PairAlignment):
        return align
    raise ConfigError(
        f"align: expected auto, off, a file or an alignment, found {type(align).__name__}."
    )


class Pipeline:
    """Detection, tracking, ranging, fusion, filters and warnings of one drive, frame by frame.

    `Pipeline.stereo` and `Pipeline.mono` create a pipeline, and `step` gives it the next frame. It
    is a context manager for use in one thread. With `deterministic=True`, results equal the results
    of `Run` with the same options and alignment.

    Example:
        >>> import track_range as tr
        >>> recording = tr.open_recording("left.mp4", "right.mp4", rig="rig.yaml", align="off")
        >>> with tr.Pipeline.stereo(recording.rig, sgbm=False, align="off") as pipeline:
        ...     for frame in recording.frames:
        ...         result = pipeline.step(frame.left, frame.right[:, :], frame.time_s)
        ...         nearest_m = min((t.filtered_m for t in result.objects if t.filtered_m > 0), default=None)
        >>> pipeline.to_arrow().num_rows > 0
        True
        >>> recording.close()

    Attributes:
        options: options of detection, tracking and ranging.
    """

    def __init__(
        self,
        cameras: _Cameras,
        options: PipelineOptions,
        *,
        detector: ObjectDetector | None = None,
        tracker: ObjectTracker | None = None,
        keep_s: float = 60.0,
        deterministic: bool = False,
    ) -> None:
        """Use `Pipeline.stereo` or `Pipeline.mono`, which check their arguments."""
        if not _is_number(keep_s) or not keep_s > 0:
            raise ConfigError(f"keep_s: expected a positive number of seconds, found {keep_s!r}.")
        if options.detections is not None:
            raise ConfigError(
                "detections: expected a detector, found recorded boxes; pass an "
                "object with detect()."
            )
        self.options = options
        self._cameras = cameras
        # unusable files are reported before the first frame
        if isinstance(cameras.models, Path):
            content = content_of(cameras.models, is_grey=False, is_pair=cameras.is_pair)
            if cameras.names or not content.cameras:  # of several, the images' size may choose
                load_calibration(cameras.models, cameras=cameras.names)
        self._align = _opened_alignment(cameras.align)
        self._is_closed = False
        self._tracker, self._has_detector = tracker, detector is not None
        load_curves(options.curves, options.region or "unknown")
        if options.stereo_model and not cameras.is_pair:
            raise ConfigError(NEEDS_PAIR)
        check_networks(options)
        if detector is not None:
            self._boxes = boxes_of(detector)
        else:
            self._boxes = network_source(
                options, lambda name: ready_model(name, Console(quiet=True)), open_detector
            )
        warm_up(options, is_pair=cameras.is_pair)
        self._keep_s, self._is_deterministic = keep_s, deterministic
        self._background: Background = InThreads() if deterministic else beside_steps()
        self._drive = self._new_drive()
        self._latencies_s: deque[float] = deque(maxlen=_N_LATENCIES)

    @classmethod
    @KeywordsInErrors(RunSettings)
    def stereo(
        cls,
        rig: str | Path | StereoRig | None = None,
        *,
        align: str | Path | Alignment | PairAlignment | None = "auto",
        keep_s: float = 60.0,
        deterministic: bool = False,
        fov_deg: float | None = None,
        camera: str | Sequence[str] = (),
        pixel_format: str | tuple[str, str] | None = None,
        **options: Unpack[PipelineKeywords],
    ) -> Self:
        """A pipeline for the images of two cameras.

        Args:
            rig: calibration file, or the models of the cameras; None = focal length and baseline
                are estimated while frames come, see `FrameResult.focal`.
            align: correction of disparities: "auto" or None = estimated from the first frames in
                motion, "off", a file of `track-range align`, or an alignment, such as
                `run.alignment`.
            keep_s: time for which rows and events are kept.
            deterministic: whether equal frames give equal results: steps then wait for the check of
                the pair, the alignment and the focal length, up to a second each. If not, these are
                used from the first frame after they are known, and a second process of low
                priority, of about 200 MB, estimates them.
            fov_deg: horizontal field of view to which images of wide lenses are undistorted; None =
                the full field.
            camera: names of the left and the right camera in a calibration file of several.
            pixel_format: format of the images, such as "rgb8", "mono16" or "nv12", or of the left
                and the right ones, see `tr.decoded_image`; None = BGR or grey, 8 bits.
            options: options of `track-range run` for detection, tracking and ranging, with
                underscores. `detector` and `tracker` may also be objects with `detect` and
                `update`.

        Raises:
            ConfigError: an option is unknown or invalid.
            RigError, ModelError, DownloadError, TrackerError: a file or network cannot be used.
        """
        if not isinstance(rig, str | Path | StereoRig | None):
            raise ConfigError(
                f"rig: expected a calibration file or a StereoRig, found {type(rig).__name__}."
            )
        values, objects = options_and_objects(PipelineOptions, {**options})
        chosen, view = pipeline_options(values), LensView(fov_deg)
        models = Path(rig) if isinstance(rig, str) else rig
        names = names_of(camera)
        given = _Cameras(models, view, align, is_pair=True, names=names, pixel_format=pixel_format)
        return cls(given, chosen, **objects, keep_s=keep_s, deterministic=deterministic)

    @classmethod
    @KeywordsInErrors(RunSettings)
    def mono(
        cls,
        *,
        focal_px: float | None = None,
        rig: Cameras | None = None,
        keep_s: float = 60.0,
        deterministic: bool = False,
        fov_deg: float | None = None,
        yaw_deg: float = 0.0,
        camera: str | Sequence[str] = (),
        pixel_format: str | None = None,
        **options: Unpack[PipelineKeywords],
    ) -> Self:
        """A pipeline for the images of one camera; see `stereo` for the other arguments.

        Args:
            focal_px: focal length of a camera without a calibration file; the principal point is
                the image centre. Without it and `rig`, a usual focal length with its wide sigma is
                assumed, and estimated while frames come, see `FrameResult.focal`.
            rig: calibration file, or the model of the camera (of a pair, the left one).
            yaw_deg: direction of the axis of the undistorted images of a wide lens, to the right of
                the lens axis.
            camera: name of the camera in a calibration file of several.

        Raises:
            ConfigError: an option is unknown or invalid; or both `focal_px` and `rig` are given.
            RigError, ModelError, DownloadError, TrackerError: a file or network cannot be used.
        """
        cameras = rig if focal_px is None else focal_px
        if focal_px is not None and rig is not None:
            raise ConfigError("expected either focal_px or rig, the calibration of the camera.")
        if focal_px is not None and not (_is_number(focal_px) and 0 < focal_px < math.inf):
            raise ConfigError(f"focal_px: expected a positive number, found {focal_px!r}.")
        if not isinstance(rig, str | Path | StereoRig | PinholeCamera | None):
            raise ConfigError(
                f"rig: expected a calibration file or a PinholeCamera, found {type(rig).__name__}."
            )
        values, objects = options_and_objects(PipelineOptions, {**options})
        chosen, view = pipeline_options(values), LensView(fov_deg, yaw_deg)
        models = Path(cameras) if isinstance(cameras, str) else cameras
        if models is None and chosen.ground is not None:
            models = read_ground(chosen.ground).plain_focal_px
        given = _Cameras(models, view, names=names_of(camera), pixel_format=pixel_format)
        return cls(given, chosen, **objects, keep_s=keep_s, deterministic=deterministic)

    @property
    def alignment(self) -> PairAlignment | None:
        """The alignment of the next frame; None = one camera, or not estimated yet."""
        calibration = self.calibration
        return None if calibration is None else calibration.alignment

    @property
    def calibration(self) -> RecordingCalibration | None:
        """The camera models of the next rectified frame; None before the first frame, which gives
        the image size.
        """
        self._use_estimates()
        parts = self._drive.parts
        return None if parts is None else parts.current

    @property
    def latency_ms(self) -> dict[str, float]:
        """`p50`, `p95` and `max` of the latencies of the last 1,000 frames in ms; empty before the
        first frame.

        They count from the time of the images if `time_s` is of `time.monotonic` or `time.time`,
        else from the call.
        """
        return latency_ms(self._latencies_s)

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user about the visibility of the latest frames, the detector, the
        calibration, the pair and the methods so far.
        """
        self._use_estimates()
        return self._notes()

    @property
    def health(self) -> Health:
        """The notes as codes with a severity, by sensor, and since when each is known: for programs,
        which should not depend on sentences. docs/how-to/robot.md has the codes.
        """
        self._use_estimates()
        self._look_at_health()
        return self._drive.health

    def _notes(self) -> tuple[str, ...]:
        drive, boxes = self._drive, self._boxes.notes()
        of_parts = () if drive.parts is None else drive.parts.notes
        return (*drive.visibility.notes(), *boxes, *drive.times.notes, *of_parts)

    def _look_at_health(self) -> None:
        drive = self._drive
        drive.health = health_of(self._notes(), drive.health, drive.time_s)

    def reset(self) -> None:
        """Start another drive with the same cameras and networks: tracks, estimates, rows and times
        are forgotten, so that the next frame may have any time.

        An own tracker object is reset if it has `reset()`.
        """
        self._check_open()
        parts = self._drive.parts
        if parts is not None:
            parts.stages.close()
        if self._boxes.fixed_parts is not None:
            self._boxes = replace(self._boxes, fixed_parts=FixedParts())
        if self._boxes.far_pass is not None:
            self._boxes.far_pass.restart()
        reset_tracker = getattr(self._tracker, "reset", None)
        if reset_tracker is not None:
            reset_tracker()
        self._drive = self._new_drive()

    def state(self) -> PipelineState:
        """What the pipeline knows after the last frame; `restore` makes a pipeline from it that goes
        on in the same way. Waits for estimates in the background.

        Networks are not part of it, nor are own detector and tracker objects.

        Raises:
            StateError: a part of another package cannot be pickled.
        """
        self._check_open()
        drive = self._drive
        sizes_px = None if drive.parts is None else drive.parts.calibration.sizes_px
        opened_with = self._cameras, self.options, self._keep_s, self._is_deterministic, sizes_px
        own = self._has_detector, self._tracker is not None
        return PipelineState(
            made_by=version("track-range"),
            n_frames=drive.n_frames,
            opened_with=dumped((opened_with, own), {}),
            content=dumped((drive, self._boxes.far_pass), self._resources(drive.parts)),
        )

    @classmethod
    def restore(
        cls,
        state: PipelineState,
        *,
        detector: ObjectDetector | None = None,
        tracker: ObjectTracker | None = None,
    ) -> Self:
        """The pipeline of a `state()`: with `deterministic=True`, its results equal those of the
        pipeline that made the state, if both get the same frames.

        Args:
            state: of the same version of track-range. It is in Python's pickle format: restore only
                states of a source that you trust.
            detector: the detector object, if the pipeline had one; a network is opened again.
            tracker: the tracker object, if the pipeline had one.

        Raises:
            StateError: the state is of another version, or an object is missing.
        """
        check_version(state, version("track-range"))
        opened_with, own = loaded(state.opened_with, {})
        for name, had, given in zip(("detector", "tracker"), own, (detector, tracker), strict=True):
            if had != (given is not None):
                given_now = "none" if had else "one"
                raise StateError(
                    f"{name}: expected {'the' if had else 'no'} {name} object, as the pipeline of "
                    f"the state was made, found {given_now}."
                )
        cameras, options, keep_s, deterministic, sizes_px = opened_with
        pipeline = cls(
            cameras,
            options,
            detector=detector,
            tracker=tracker,
            keep_s=keep_s,
            deterministic=deterministic,
        )
        fresh = None if sizes_px is None else pipeline._open(sizes_px)
        drive, far_pass = loaded(state.content, pipeline._resources(fresh))
        if fresh is not None:
            fresh.stages.ranging.close(fresh.stages.clock)
        pipeline._drive = drive
        if far_pass is not None and pipeline._boxes.far_pass is not None:
            vars(pipeline._boxes.far_pass).update(vars(far_pass))
        return pipeline

    def _resources(self, parts: _Parts | None) -> dict[str, object]:
        """What a state does not contain, by name."""
        own: dict[str, object] = {"background": self._background, "tracker": self._tracker}
        if parts is None:
            return own
        stages = parts.stages
        detection = stages.detection
        networks = {name: getattr(detection, name) for name in ("detect", "prepare", "candidates")}
        networks |= {
            f"network of {name}": one.network for name, one in stages.ranging.rangers.items()
        }
        return {**own, **networks, "restarted": stages.restarted}

    def _new_drive(self) -> _Drive:
        is_off = self.options.static_camera
        finder = EventFinder(self.options.event_settings, is_off=is_off)
        return _Drive(RecentRows(self._keep_s, finder))

    def _check_open(self) -> None:
        if self._is_closed:
            raise UsageError("this pipeline is closed; create a new one for further frames.")

    def events(self) -> tuple[Event, ...]:
        """Events of the last `keep_s` seconds, including events in progress; times count from the
        first frame.
        """
        return self._drive.rows.events()

    def to_arrow(self) -> pa.Table:
        """Rows of the last `keep_s` seconds as in tracks.csv; times count from the first frame."""
        return self._drive.rows.to_arrow()

    def close(self) -> None:
        """End the threads; rows and events remain, but no frame may follow."""
        self._is_closed = True
        self._background.close()
        if self._drive.parts is not None:
            self._drive.parts.stages.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    @overload
    def step(
        self,
        left: Image,
        right: Image | None,
        time_s: float | None = None,
        *,
        ego_speed_mps: float | None = None,
        time_ns: int | None = None,
        pixel_format: str | tuple[str, str] | None = None,
    ) -> FrameResult: ...

    @overload
    def step(
        self,
        image: Image,
        time_s: float,
        /,
        *,
        ego_speed_mps: float | None = None,
        pixel_format: str | None = None,
    ) -> FrameResult: ...

    @overload
    def step(
        self,
        left: Image,
        *,
        time_s: float | None = None,
        ego_speed_mps: float | None = None,
        time_ns: int | None = None,
        pixel_format: str | None = None,
    ) -> FrameResult: ...

    @overload
    def step(
        self,
        *,
        image: Image,
        time_s: float | None = None,
        ego_speed_mps: float | None = None,
        time_ns: int | None = None,
        pixel_format: str | None = None,
    ) -> FrameResult: ...

    @KeywordsInErrors(RunSettings)
    def step(
        self,
        left: Image | None = None,
        right: Image | float | None = None,
        time_s: float | None = None,
        *,
        image: Image | None = None,
        ego_speed_mps: float | None = None,
        time_ns: int | None = None,
        pixel_format: str | tuple[str, str] | None = None,
    ) -> FrameResult:
        """Result of the next frame: `step(left, right, time_s)`, of one camera `step(image, time_s)`.

        Args:
            left: image of the left or only camera, (H, W, 3) uint8 BGR or (H, W) uint8, or in the
                `pixel_format`, as recorded (not rectified, unless the rig is). The images are not
                copied: do not change them afterwards.
            right: image of the right camera at the same time; left out or None for one camera.
            time_s: time of the images in seconds on any clock; must increase. Times in results
                count from the first frame.
            image: another name of `left` for one camera.
            ego_speed_mps: speed of the camera along its axis, with `mount` that of the vehicle,
                negative = backwards; None or NaN = measured from the images.
            time_ns: the time in whole nanoseconds, as ROS has it, in place of `time_s`.
            pixel_format: format of the images of this frame, in place of that of the pipeline.

        Raises:
            FrameError: an image has another size or type than the first image, the time does not
                increase, or the number of images is not that of the cameras.
            RigError: the first images do not fit the rig, or left and right are swapped.
            DetectorError, TrackerError, MethodError: an object of another package returned
                something else.
        """
        called_s = time.monotonic(), time.time()
        self._check_open()
        images, time_s = self._arguments(left, right, time_s, image, pixel_format)
        known = _known_motion(ego_speed_mps)
        drive = self._drive
        moment = drive.times.moment(time_s, time_ns)
        result = self._result(images, moment, known)
        drive.times.add(moment)
        drive.n_frames += 1
        drive.rows.add(result)
        drive.visibility.add(result)
        drive.time_s = result.time_s
        if drive.time_s >= drive.checked_s + _HEALTH_S:
            drive.checked_s = drive.time_s
            self._look_at_health()
        clock_s = moment.clock_s
        waited_s = next(
            (now_s - clock_s for now_s in called_s if abs(now_s - clock_s) < _SAME_CLOCK_S), 0.0
        )
        self._latencies_s.append(max(waited_s, 0.0) + time.monotonic() - called_s[0])
        return result

    def _arguments(
        self, left: Any, right: Any, time_s: Any, image: Any, pixel_format: Any
    ) -> tuple[dict[str, Image], Any]:
        """The checked images by name, and the time, of the two ways to call `step`."""
        if self._cameras.is_pair:
            named = {"left": left, "right": right}
        else:
            if time_s is None and not isinstance(right, np.ndarray):
                right, time_s = None, right
            if right is not None:
                raise FrameError(
                    "right: expected one image, since this pipeline has one camera, found two; use "
                    "Pipeline.stereo for two cameras."
                )
            named = {"image": left if image is None else image}
        formats = _formats(pixel_format or self._cameras.pixel_format)
        checked = {
            name: _checked(one, name, formats["right" if name == "right" else "left"])
            for name, one in named.items()
        }
        return checked, time_s

    def _result(
        self, images: Mapping[str, Image], moment: Moment, known: EgoMotion | None
    ) -> FrameResult:
        """The result of images; after an error, the pipeline is as before."""
        drive = self._drive
        parts = drive.parts
        if parts is None:
            parts = self._open(tuple((one.shape[1], one.shape[0]) for one in images.values()))
        parts.check_sizes(images)
        time_s = drive.times.since_first_s(moment)
        recorded = RecordedFrame(drive.n_frames, time_s, tuple(images.values()))
        try:
            result = parts.step(recorded, known)
        except BaseException:
            # a first frame that is refused does not fix the size of the images
            if drive.parts is None:
                parts.stages.close()
            raise
        drive.parts = parts
        if parts.aligner is not None:
            parts.aligner.estimate()
        return result

    def _use_estimates(self) -> None:
        """Use the estimates of the alignment that are ready."""
        parts = self._drive.parts
        if parts is not None and parts.aligner is not None:
            parts.aligner.use_estimates()

    def _open(self, sizes_px: tuple[tuple[int, int], ...]) -> _Parts:
        cameras = self._cameras.models
        if not isinstance(cameras, Path | StereoRig | PinholeCamera | None):
            cameras = PinholeCamera.of_focal_length(float(cameras), sizes_px[0])
            check_camera(cameras, "focal_px")
        lens = GivenLens(self.options.camera_model, self.options.lens_fov_deg)
        given = self._cameras
        calibration = calibration_of(cameras, sizes_px, given.view, given.names, lens)
        aligner = None
        if calibration.rig is not None:
            alignment = given_alignment(self._align, calibration.rig)
            aligner = PairAligner(calibration, ONE_BY_ONE, alignment, background=self._background)
        stages = open_pipeline(
            self.options,
            calibration if aligner is None else aligner.calibration,
            outside_regions(self._boxes, self.options.ignore, calibration),
            region=self.options.region or "unknown",
            tracker=self._tracker,
            background=self._background,
        )
        return _Parts(calibration, aligner, stages)


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _known_motion(ego_speed_mps: float | None) -> EgoMotion | None:
    if ego_speed_mps is None:
        return None
    if (
        not _is_number(ego_speed_mps)
        or ego_speed_mps > MAX_SPEED_MPS
        or ego_speed_mps < -_MAX_BACKWARDS_MPS
    ):
        limits = f"-{_MAX_BACKWARDS_MPS:.0f} (backwards) to {MAX_SPEED_MPS:.0f} m/s"
        raise FrameError(
            f"ego_speed_mps: expected a number from {limits}, found {ego_speed_mps!r}."
        )
    return None if math.isnan(ego_speed_mps) else EgoMotion(float(ego_speed_mps), TABLE_SIGMA_MPS)


def _formats(
    pixel_format: str | tuple[str, str] | None,
) -> dict[str, str | None]:
    """The pixel formats of the left or only, and of the right camera; None = BGR or grey."""
    if isinstance(pixel_format, tuple | list) and len(pixel_format) == 2:
        left, right = pixel_format
        return {"left": left, "right": right}
    if pixel_format is None or isinstance(pixel_format, str):
        return {"left": pixel_format, "right": pixel_format}
    raise ConfigError(f"pixel_format: expected a name, of a pair also two, found {pixel_format!r}.")


def _checked(image: Any, name: str, pixel_format: str | None) -> Image:
    """An image as (H, W, 3) uint8 BGR; a right image may be grey."""
    if pixel_format is not None:
        return bgr_of(image, pixel_format, name, keeps_grey=name == "right")
    if (
        not isinstance(image, np.ndarray)
        or image.dtype != np.uint8
        or image.ndim not in (2, 3)
        or 0 in image.shape
    ):
        got = (
            f"{image.dtype} {image.shape}"
            if isinstance(image, np.ndarray)
            else type(image).__name__
        )
        raise FrameError(
            f"{name}: expected an image, uint8 (H, W, 3) in BGR or (H, W), found {got}; name other "
            "formats by pixel_format."
        )
    if image.ndim == 3 and image.shape[2] != 3:
        raise FrameError(
            f"{name}: expected 3 channels in BGR, found {image.shape[2]}; name other formats by "
            "pixel_format."
        )
    is_grey_left = image.ndim == 2 and name != "right"
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)) if is_grey_left else image
