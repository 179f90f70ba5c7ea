"""Pipeline: everything that a run does with a frame, for frames in memory, from a driver, a robot or a ROS node.

    check the images -> rectify -> FramePipeline.step -> rows and events -> alignment for the next frame

Nothing is read ahead: the alignment of a pair is estimated while the frames come (`StepwiseAlignment`).
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from numbers import Real
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import cv2
import numpy as np
from rich.console import Console

from track_range.detection.detector import ObjectDetector
from track_range.foundation.arrays import Image
from track_range.foundation.errors import ConfigError, UsageError, UserError
from track_range.foundation.keywords import KeywordsInErrors
from track_range.pipeline.frame_pipeline import FramePipeline
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.throughput import latency_ms
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.world.ego_speed import MAX_SPEED_MPS, TABLE_SIGMA_MPS
from track_range.recording.cameras.calibration import LensView, RecordingCalibration, calibration_of
from track_range.recording.pairs.auto_alignment import (
    PairAlignment,
    StepwiseAlignment,
    given_alignment,
)
from track_range.recording.pairs.pair_monitor import PairMonitor
from track_range.recording.pairs.sync_monitor import SyncMonitor
from track_range.results.events.event import Event
from track_range.results.events.finder import EventFinder
from track_range.results.table import RecentRows
from track_range.run.box_source import boxes_of, network_source, outside_regions
from track_range.run.build import open_pipeline
from track_range.run.options.opened import open_detector
from track_range.run.ready_model import ready_model
from track_range.run.settings import PipelineOptions, RunSettings
from track_range.run.settings_files import options_and_objects, pipeline_options
from track_range.stereo.alignment.file import load_alignment
from track_range.stereo.alignment.model import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.geometry.rig_checks import check_camera
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.stereo.rig_formats.reading import load_calibration
from track_range.tracking.registry import ObjectTracker

if TYPE_CHECKING:
    from typing import Unpack

    import pyarrow as pa

    from track_range.run.option_types import PipelineKeywords

Cameras = str | Path | StereoRig | PinholeCamera  # a calibration file, or the models of the cameras


_MAX_BACKWARDS_MPS = 20.0  # largest plausible speed backwards; a faster one has the wrong sign
_N_LATENCIES = 1000  # latest frames of which the latency is stated
# steps between frames, so many in a row, that are probably no seconds
_LONG_STEP_S, _N_LONG_STEPS = 5.0, 3
# largest difference between a frame's time and a clock of this machine that stamps the images
_SAME_CLOCK_S = 10.0


class FrameError(UserError, ValueError):
    """Images or a time that a pipeline cannot use; the pipeline is as before."""


class Pipeline:
    """Detection, tracking, ranging, fusion, filters and warnings of one drive, frame by frame.

    `Pipeline.stereo` and `Pipeline.mono` create a pipeline, which is a context manager for use in
    one thread. Results equal the results of `Run` with the same options and alignment.

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
        cameras: Cameras | float,
        options: PipelineOptions,
        *,
        detector: ObjectDetector | None = None,
        tracker: ObjectTracker | None = None,
        align: str | Path | Alignment | PairAlignment | None = "auto",
        view: LensView,
        keep_s: float = 60.0,
    ) -> None:
        if not _is_number(keep_s) or not keep_s > 0:
            raise ConfigError(f"keep_s: expected a positive number of seconds, found {keep_s!r}.")
        if options.detections is not None:
            raise ConfigError(
                "detections: expected a detector, found recorded boxes; pass an "
                "object with detect()."
            )
        self.options = options
        self._cameras = Path(cameras) if isinstance(cameras, str) else cameras
        if isinstance(self._cameras, Path):
            load_calibration(self._cameras)  # an unusable file is reported before the first frame
        if isinstance(align, str | Path) and align not in ("auto", "off"):
            align = load_alignment(align)
        elif align is not None and not isinstance(align, str | Alignment | PairAlignment):
            raise ConfigError(
                f"align: expected auto, off, a file or an alignment, found {type(align).__name__}."
            )
        self._align, self._view = "auto" if align is None else align, view
        self._is_closed = False
        self._tracker = tracker
        self._size_model = load_curves(options.curves, options.region or "unknown")
        if detector is not None:
            self._boxes = boxes_of(detector)
        else:
            self._boxes = network_source(
                options, lambda name: ready_model(name, Console(quiet=True)), open_detector
            )
        self._rows = RecentRows(keep_s, EventFinder(options.event_settings))
        self._opened: _Opened | None = None
        self._index, self._first_s, self._last_s = 0, math.nan, -math.inf
        self._n_long_steps = 0  # in a row, up to the last frame
        self._latencies_s: deque[float] = deque(maxlen=_N_LATENCIES)

    @classmethod
    @KeywordsInErrors(RunSettings)
    def stereo(
        cls,
        rig: str | Path | StereoRig,
        *,
        align: str | Path | Alignment | PairAlignment | None = "auto",
        keep_s: float = 60.0,
        fov_deg: float | None = None,
        **options: Unpack[PipelineKeywords],
    ) -> StereoPipeline:
        """A pipeline for the images of two cameras.

        Args:
            rig: calibration file, or the models of the cameras.
            align: correction of disparities: "auto" or None = estimated from the first frames in
                motion, "off", a file of `track-range align`, or an alignment, such as
                `run.alignment`.
            keep_s: time for which rows and events are kept.
            fov_deg: horizontal field of view to which images of wide lenses are undistorted; None =
                the full field.
            options: options of `track-range run` for detection, tracking and ranging, with
                underscores. `detector` and `tracker` may also be objects with `detect` and
                `update`.

        Raises:
            ConfigError: an option is unknown or invalid.
            RigError, ModelError, DownloadError, TrackerError: a file or network cannot be used.
        """
        if not isinstance(rig, str | Path | StereoRig):
            raise ConfigError(
                f"rig: expected a calibration file or a StereoRig, found {type(rig).__name__}."
            )
        values, objects = options_and_objects(PipelineOptions, {**options})
        chosen, view = pipeline_options(values), LensView(fov_deg)
        return StereoPipeline(rig, chosen, **objects, align=align, view=view, keep_s=keep_s)

    @classmethod
    @KeywordsInErrors(RunSettings)
    def mono(
        cls,
        *,
        focal_px: float | None = None,
        rig: Cameras | None = None,
        keep_s: float = 60.0,
        fov_deg: float | None = None,
        yaw_deg: float = 0.0,
        **options: Unpack[PipelineKeywords],
    ) -> MonoPipeline:
        """A pipeline for the images of one camera; see `stereo` for the other arguments.

        Args:
            focal_px: focal length of a camera without a calibration file; the principal point is
                the image centre.
            rig: calibration file, or the model of the camera (of a pair, the left one).
            yaw_deg: direction of the axis of the undistorted images of a wide lens, to the right of
                the lens axis.

        Raises:
            ConfigError: an option is unknown or invalid; or not exactly one of `focal_px` and `rig`
                is given.
            RigError, ModelError, DownloadError, TrackerError: a file or network cannot be used.
        """
        cameras = rig if focal_px is None else focal_px
        if cameras is None or None not in (rig, focal_px):
            raise ConfigError("expected either focal_px or rig, the calibration of the camera.")
        if focal_px is not None and not (_is_number(focal_px) and 0 < focal_px < math.inf):
            raise ConfigError(f"focal_px: expected a positive number, found {focal_px!r}.")
        if focal_px is None and not isinstance(cameras, str | Path | StereoRig | PinholeCamera):
            raise ConfigError(
                f"rig: expected a calibration file or a PinholeCamera, found {type(rig).__name__}."
            )
        values, objects = options_and_objects(PipelineOptions, {**options})
        chosen, view = pipeline_options(values), LensView(fov_deg, yaw_deg)
        return MonoPipeline(cameras, chosen, **objects, align="off", view=view, keep_s=keep_s)

    @property
    def alignment(self) -> PairAlignment | None:
        """The alignment of the next frame; None = one camera, or not estimated yet."""
        return None if self._opened is None else self._opened.alignment

    @property
    def calibration(self) -> RecordingCalibration | None:
        """The camera models of the next rectified frame; None before the first frame, which gives
        the image size.
        """
        return None if self._opened is None else self._opened.next_calibration

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
        """Messages for the user about the detector, the calibration, the pair and the methods so
        far.
        """
        boxes = self._boxes.notes()
        if self._opened is None:
            return boxes
        unit = (
            "time_s: the latest frames are more than 5 s apart, so no road user is tracked; give "
            "time_s in seconds."
        )
        return (
            *boxes,
            *([unit] if self._n_long_steps == _N_LONG_STEPS else []),
            *self._opened.notes,
        )

    def events(self) -> tuple[Event, ...]:
        """Events of the last `keep_s` seconds, including events in progress; times count from the
        first frame.
        """
        return self._rows.events()

    def to_arrow(self) -> pa.Table:
        """Rows of the last `keep_s` seconds as in tracks.csv; times count from the first frame."""
        return self._rows.to_arrow()

    def close(self) -> None:
        """End the threads; rows and events remain, but no frame may follow."""
        self._is_closed = True
        if self._opened is not None:
            self._opened.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    @KeywordsInErrors(RunSettings)
    def _step(
        self, images: Mapping[str, Any], time_s: float, ego_speed_mps: float | None
    ) -> FrameResult:
        called_s = time.monotonic(), time.time()
        if self._is_closed:
            raise UsageError("this pipeline is closed; create a new one for further frames.")
        checked = {
            name: _checked(image, name, is_left=name != "right") for name, image in images.items()
        }
        known, opened = _known_motion(ego_speed_mps), self._opened
        if not _is_number(time_s) or not self._last_s < time_s < math.inf:
            after = f" after {self._last_s} s, the time of the last frame" if self._index else ""
            raise FrameError(f"time_s: expected a time in seconds{after}, found {time_s!r}.")
        time_s = float(time_s)
        if opened is None:
            opened = self._open(
                tuple((image.shape[1], image.shape[0]) for image in checked.values())
            )
        opened.check_sizes(checked)
        first_s = time_s if math.isnan(self._first_s) else self._first_s
        try:
            result = opened.step(list(checked.values()), self._index, time_s - first_s, known)
        except BaseException:
            # a first frame that is refused does not fix the size of the images
            if self._opened is None:
                opened.close()
            raise
        is_long = self._index > 0 and time_s - self._last_s > _LONG_STEP_S
        self._n_long_steps = min(self._n_long_steps + 1, _N_LONG_STEPS) if is_long else 0
        self._opened, self._first_s, self._last_s = opened, first_s, time_s
        self._index += 1
        self._rows.add(result)
        waited_s = next(
            (now_s - time_s for now_s in called_s if abs(now_s - time_s) < _SAME_CLOCK_S), 0.0
        )
        self._latencies_s.append(max(waited_s, 0.0) + time.monotonic() - called_s[0])
        return result

    def _open(self, sizes_px: tuple[tuple[int, int], ...]) -> _Opened:
        cameras = self._cameras
        if not isinstance(cameras, Path | StereoRig | PinholeCamera):
            cameras = PinholeCamera.of_focal_length(float(cameras), sizes_px[0])
            check_camera(cameras, "focal_px")
        calibration = calibration_of(cameras, sizes_px, self._view)
        given = None if calibration.rig is None else given_alignment(self._align, calibration.rig)
        stepwise = None if calibration.rig is None else StepwiseAlignment(calibration.rig, given)
        aligned = calibration if given is None else calibration.with_alignment(given)
        stages = open_pipeline(
            self.options,
            aligned,
            outside_regions(self._boxes, self.options.ignore, calibration),
            self._size_model,
            region=self.options.region or "unknown",
            tracker=self._tracker,
            alignment=stepwise if given is None else None,
        )
        return _Opened(calibration, aligned, stages, stepwise)


class StereoPipeline(Pipeline):
    """The pipeline of two cameras."""

    def step(
        self, left: Image, right: Image, time_s: float, *, ego_speed_mps: float | None = None
    ) -> FrameResult:
        """Result of the next frame.

        Args:
            left: (H, W, 3) uint8 BGR or (H, W) uint8, as recorded (not rectified, unless the rig
                is). The images are not copied: do not change them afterwards.
            right: image of the right camera at the same time.
            time_s: time of the images in seconds on any clock; must increase. Times in results
                count from the first frame.
            ego_speed_mps: speed of the camera, negative = backwards; None or NaN = measured from
                the images (in a `MonoPipeline` only with `camera_height_m`).

        Raises:
            FrameError: an image has another size or type than the first image, or the time does not
                increase.
            RigError: the first images do not fit the rig, or left and right are swapped.
            DetectorError, TrackerError, MethodError: an object of another package returned
                something else.
        """
        return self._step({"left": left, "right": right}, time_s, ego_speed_mps)


class MonoPipeline(Pipeline):
    """The pipeline of one camera."""

    def step(
        self, image: Image, time_s: float, *, ego_speed_mps: float | None = None
    ) -> FrameResult:
        """Result of the next frame; see `StereoPipeline.step`."""
        return self._step({"image": image}, time_s, ego_speed_mps)


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


def _checked(image: Any, name: str, *, is_left: bool) -> Image:
    """An image as (H, W, 3) uint8 BGR; a right image may be grey."""
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
            f"{name}: expected an image, uint8 (H, W, 3) in BGR or (H, W), found {got}."
        )
    if image.ndim == 3 and image.shape[2] != 3:
        raise FrameError(f"{name}: expected 3 channels in BGR, found {image.shape[2]}.")
    return (
        np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
        if image.ndim == 2 and is_left
        else image
    )


class _Opened:
    """A pipeline after its first frame: calibrations without and with the alignment, and the
    stages.
    """

    def __init__(
        self,
        unaligned: RecordingCalibration,
        aligned: RecordingCalibration,
        stages: FramePipeline,
        stepwise: StepwiseAlignment | None,
    ) -> None:
        self._unaligned, self.calibration, self._stages, self._stepwise = (
            unaligned,
            aligned,
            stages,
            stepwise,
        )
        rig = unaligned.rig
        self._monitor = None if stepwise is None or rig is None else PairMonitor(rig)
        self._sync = SyncMonitor()
        # The alignment for the next frame is estimated while the caller waits for that frame.
        self._is_given = stepwise is not None and stepwise.current is not None
        self._has_stereo = self._monitor is None  # not before the first pairs are explained
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="alignment")
        self._pending: Future[PairAlignment | None] | None = None

    @property
    def alignment(self) -> PairAlignment | None:
        self._apply()
        return None if self._stepwise is None else self._stepwise.current

    @property
    def next_calibration(self) -> RecordingCalibration:
        self._apply()
        return self.calibration

    @property
    def notes(self) -> tuple[str, ...]:
        self._apply()
        pair = () if self._monitor is None else self._monitor.notes
        stages = self._stages
        scale = stages.doubting.notes()
        return (
            *self.calibration.notes,
            *pair,
            *self._sync.notes,
            *stages.notes,
            *stages.ranging.notes(),
            *scale,
        )

    def check_sizes(self, images: Mapping[str, Image]) -> None:
        for (name, image), size_px in zip(images.items(), self._unaligned.sizes_px, strict=True):
            if (image.shape[1], image.shape[0]) != size_px:
                got = f"{image.shape[1]}x{image.shape[0]}"
                raise FrameError(
                    f"{name}: expected {size_px[0]}x{size_px[1]} px as before, found {got} px."
                )

    def step(
        self, images: Sequence[Image], index: int, time_s: float, known: EgoMotion | None
    ) -> FrameResult:
        self._apply()
        recorded = self.calibration.frame_of(images, index, time_s)
        (frame,) = self._sync.add(recorded)
        has_stereo, finding = self._has_stereo, None
        if self._monitor is not None:
            before = self._monitor.finding
            self._monitor.add(frame)
            is_same = before is not None and before is self._monitor.finding
            has_stereo = (
                self._has_stereo if is_same else self._checked(self._monitor, is_first=index == 0)
            )
            finding = self._monitor.finding
        shown = frame if has_stereo else replace(frame, right=None)
        result = self._stages.step(self._stages.detected(shown), known)
        is_usable = frame is recorded and (finding is None or finding.has_stereo)
        if self._stepwise is not None and self._stepwise.is_active and is_usable:
            # the alignment is estimated without the correction of rows and shifts
            unaligned = frame
            if self.calibration.rectifier is not self._unaligned.rectifier:
                unaligned = self._unaligned.frame_of(images, index, time_s)
            self._pending = self._thread.submit(self._stepwise.add, unaligned, frame)
        return result

    def _checked(self, monitor: PairMonitor, *, is_first: bool) -> bool:
        """Whether the checked frame has stereo: not before the first pairs are explained, and not
        if they are repaired.

        With a given alignment, the first pair decides until the pairs are explained.
        """
        if monitor.finding is None or self._stepwise is None:
            if is_first and self._is_given:
                self._has_stereo = monitor.has_stereo_so_far
            return self._has_stereo
        if self._is_given:
            monitor.finding = monitor.finding.uncorrected()
        finding = monitor.finding
        self._has_stereo, is_repaired = finding.has_stereo, finding.fault in ("verged", "turned")
        if finding.fault == "turned":
            self._unaligned, self.calibration = self._unaligned.turned(), self.calibration.turned()
        if is_repaired and not self._is_given:
            self._pending = None
            self._stepwise.restart(finding.prior)
            if self._stepwise.current is not None:
                self._unaligned = self.calibration = self._unaligned.with_alignment(
                    self._stepwise.current
                )
        return self._has_stereo and not is_repaired

    def _apply(self) -> None:
        """Use the alignment that was estimated since the last frame."""
        pending, self._pending = self._pending, None
        if pending is not None and (alignment := pending.result()) is not None:
            self.calibration = self._unaligned.with_alignment(alignment)

    def close(self) -> None:
        self._thread.shutdown(wait=True)
        self._stages.close()
