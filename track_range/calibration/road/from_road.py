"""Calibration of one camera from a drive: known metres, shapes of road users, lane lines and the
file's metadata.

guesses of the focal length (focal_sources) -> boxes and horizon of parts of the video
(road_evidence) -> focal length from guesses and shapes (focal_evidence) -> all measurements
together (camera_fit) -> rig.yaml
"""

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from track_range.calibration.road.road_evidence import (
    KnownMetres,
    RoadEvidence,
    known_lanes,
    known_metres,
)
from track_range.calibration.settings import CalibrationSettings
from track_range.detection.boxes import iou
from track_range.detection.detections import Detections
from track_range.foundation.errors import UsageError
from track_range.foundation.files.output_files import check_outputs, write_json
from track_range.foundation.progress import StepProgress, no_progress
from track_range.ranging.cameras.camera_fit import (
    HEIGHT_M,
    HEIGHT_SIGMA,
    CameraFit,
    fit_camera,
)
from track_range.ranging.cameras.focal_evidence import FocalPosterior, focal_posterior
from track_range.ranging.cameras.measurements import (
    CameraMeasurements,
    KnownObject,
    SceneBoxes,
)
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.size_model import SIZE_CLASSES, SizeModel
from track_range.recording.cameras.focal_sources import focal_guesses
from track_range.recording.recording import open_recording
from track_range.recording.sources.names import VideoName, source_of, video_name
from track_range.recording.sources.open_video import open_video
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.focal_guess import FocalGuess
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import Mounting
from track_range.stereo.rig_formats.rig_yaml import save_camera

# standard deviation relative to that of the prior below which the measurements determine a
# parameter
_DETERMINED = 0.7
_INSEPARABLE = 0.85  # magnitude of the correlation above which two parameters cannot be separated
_PART_S = 10.0  # length of each part of the video that is read
# starts of the parts, as fractions of the video, if it is longer than all of them
_PARTS = (0.1, 0.5, 0.85)
_MIN_IOU = 0.4  # smallest IoU of a detection with a box of the user whose class it gives
_MEASURED_HEIGHT_SIGMA_M = 0.03  # standard deviation of a measured camera height
# smallest and largest height of a camera above the road that measurements may give, m
_CAMERA_HEIGHT_M = (0.3, 5.0)
_FRAME_S = 0.5  # length of the part that is read for the frame of a measurement

Detect = Callable[[Frame], Detections]


@dataclass(frozen=True, slots=True)
class RoadCalibration:
    """A camera calibrated from a drive."""

    source: str  # the video
    fit: CameraFit
    guesses: tuple[FocalGuess, ...]  # guesses of the focal length from outside the images
    by_shape: FocalPosterior  # focal length from these and the shapes of road users
    sentences: tuple[str, ...]  # what the measurements determine, in words
    n_frames: int  # number of frames that were read

    @property
    def mounting(self) -> Mounting:
        """Height and pitch of the camera, and the uncertainty of its focal length."""
        fit = self.fit
        return Mounting(
            focal_sigma=round(fit.focal_sigma, 4),
            camera_height_m=round(fit.height_m, 3),
            camera_height_sigma_m=round(fit.height_sigma_m, 3),
            pitch_deg=round(float(np.degrees(fit.pitch_rad)), 3),
            pitch_sigma_deg=round(float(np.degrees(fit.pitch_sigma_rad)), 3),
        )

    def save(self, settings: CalibrationSettings) -> list[Path]:
        """Write the camera and perhaps the results, and return their paths; OutputError or
        RigError.
        """
        known = len({residual.name for residual in self.fit.residuals})
        comments = [
            f"track-range calibrate: from the road, {known} measurements, no lens distortion"
        ]
        save_camera(self.fit.camera, settings.out, comments=comments, mounting=self.mounting)
        write_json(settings.json_file, self.figures)
        return [file for file in (settings.out, settings.json_file) if file is not None]

    @property
    def figures(self) -> dict[str, Any]:
        """All values, as plain values for JSON."""
        fit, (shape_px, shape_sigma) = self.fit, self.by_shape.guess
        return {
            "source": self.source,
            "frames": self.n_frames,
            "focal_px": fit.camera.fx_px,
            **asdict(self.mounting),
            "roll_deg": float(np.degrees(fit.roll_rad)),
            "focal_height_sigma": fit.product_sigma,
            "guesses": [asdict(guess) for guess in self.guesses],
            "by_shape": {
                "focal_px": shape_px,
                "sigma": shape_sigma,
                "tracks": self.by_shape.n_tracks,
                "box_noise": self.by_shape.relative_noise,
            },
            "residuals": [asdict(residual) for residual in fit.residuals],
            "determined": list(self.sentences),
        }


def calibrate_on_road(
    settings: CalibrationSettings,
    open_detect: Callable[[], Detect],
    progress: StepProgress = no_progress,
) -> RoadCalibration:
    """Calibrate the camera of the video `settings.mono`; nothing is written before
    `RoadCalibration.save`.

    `open_detect` opens the detector. Raises UsageError if a measurement is invalid, or outside the
    image or the video, and VideoError if the video cannot be read.
    """
    if settings.mono is None:
        raise UsageError(
            "expected --mono VIDEO; without --board, one camera is calibrated from a drive."
        )
    objects = known_metres(settings.known_distance, settings.known_height, settings.known_width)
    lanes = known_lanes(settings.known_lane_width)
    video = video_name(settings.mono)
    check_outputs(
        [file for file in (settings.out, settings.json_file) if file is not None],
        source_of(video).files,
    )
    drive = _Drive.of(video, settings.camera_model)
    for known in objects:
        hint = "a box inside the image of {} px; measure it in the original video"
        drive.check_inside(known.text, hint, known.xyxy_px, known.time_s)
    for lane in lanes:
        x1, x2 = sorted((lane.x1_px, lane.x2_px))
        hint = "columns and a row inside the image of {} px"
        name = f"--known-lane-width {lane.name}"
        drive.check_inside(name, hint, (x1, lane.y_px, x2, lane.y_px), lane.time_s)

    # Boxes and horizon, with a focal length from the guesses alone.
    start = focal_posterior(drive.guesses, SceneBoxes(), drive.size_px, None)
    camera = PinholeCamera.of_focal_length(start.guess[0], drive.size_px)
    detect = open_detect()
    view = _evidence(drive, camera, detect, progress)
    known_objects = _known_objects(objects, video, camera, detect)

    # Focal length by shapes, then all measurements together.
    sizes = load_curves(settings.curves, "europe")
    cuboids = sizes if isinstance(sizes, CuboidSizes) else None
    by_shape = focal_posterior(drive.guesses, view.scene, drive.size_px, cuboids)
    measured = CameraMeasurements(
        objects=known_objects,
        lanes=lanes,
        horizon=view.horizon,
        scene=view.scene,
        scene_noise=by_shape.relative_noise,
    )
    prior = FocalGuess(*by_shape.guess, "")
    fit = _fitted(drive.size_px, prior, sizes, measured, settings.camera_height_m)
    has_height = settings.camera_height_m is not None
    sentences = separability(fit, drive.guesses, by_shape, has_height=has_height)
    return RoadCalibration(settings.mono, fit, drive.guesses, by_shape, sentences, view.n_frames)


@dataclass(frozen=True, slots=True)
class _Drive:
    """What is known of a recorded drive before it is read."""

    video: VideoName
    size_px: tuple[int, int]  # width, height
    duration_s: float  # 0 = unknown
    guesses: tuple[FocalGuess, ...]  # of the focal length, from outside the images

    @classmethod
    def of(cls, video: VideoName, camera_model: str | None) -> "_Drive":
        """The drive of a video; UsageError for a live source."""
        if not source_of(video).files:
            raise UsageError(
                f"--mono {video}: expected a recorded video, found a live source; record "
                "the camera first."
            )
        with closing(open_video(video)) as reader:
            duration_s = (reader.n_frames or 0) / reader.fps if reader.fps else 0.0
            guesses = focal_guesses(reader, camera_model)
            return cls(video, reader.shown_size_px, duration_s, guesses)

    @property
    def parts_s(self) -> list[tuple[float, float]]:
        """Start and length of each part that is read: three of a long drive, all of a short one."""
        whole_s = _PART_S * len(_PARTS)
        if self.duration_s <= whole_s:
            return [(0.0, whole_s)]
        return [(fraction * self.duration_s, _PART_S) for fraction in _PARTS]

    def check_inside(
        self, name: str, expected: str, xyxy_px: tuple[float, float, float, float], time_s: float
    ) -> None:
        """Raise UsageError for a measurement outside the image or the video."""
        x1, y1, x2, y2 = xyxy_px
        width_px, height_px = self.size_px
        if x1 < -1 or y1 < -1 or x2 > width_px or y2 > height_px:
            raise UsageError(f"{name}: expected {expected.format(f'{width_px}x{height_px}')}.")
        if self.duration_s and time_s > self.duration_s + 1.0:
            raise UsageError(
                f"{name}: expected a time up to {self.duration_s:.1f} s, the end of the video."
            )


def _evidence(
    drive: _Drive, camera: PinholeCamera, detect: Detect, progress: StepProgress
) -> RoadEvidence:
    view = RoadEvidence(camera)
    with progress("finding road users and lane lines") as advance:
        for start_s, duration_s in drive.parts_s:
            recording = open_recording(
                drive.video, focal_px=camera.fx_px, start_s=start_s, duration_s=duration_s
            )
            with closing(recording):
                view.add(recording.frames, detect, advance)
    return view


def _fitted(
    size_px: tuple[int, int],
    focal: FocalGuess,
    sizes: SizeModel,
    measured: CameraMeasurements,
    camera_height_m: float | None,
) -> CameraFit:
    """The camera by all measurements; UsageError if its height is impossible."""
    height = HEIGHT_M, HEIGHT_SIGMA * HEIGHT_M
    if camera_height_m is not None:
        height = camera_height_m, _MEASURED_HEIGHT_SIGMA_M
    fit = fit_camera(size_px, focal, sizes, measured, height=height)
    low, high = _CAMERA_HEIGHT_M
    if not low <= fit.height_m <= high:
        raise UsageError(
            f"expected measurements that give a camera height of {low:g} to {high:g} m, found "
            f"{fit.height_m:.2f} m; check the boxes, the rows of lanes, and the distances in "
            "metres."
        )
    return fit


def focal_from_video(
    video: VideoName,
    guesses: Sequence[FocalGuess],
    detect: Detect,
    sizes: SizeModel,
    *,
    span_s: tuple[float, float | None],
    folder_fps: float = 10.0,
    advance: Callable[[int, int | None], None] | None = None,
) -> FocalPosterior:
    """Focal length from guesses and the shapes of road users in the first `_PART_S` of a part of a
    video.

    `span_s` is the start and the length of the part, None = to the end; `advance` is called after
    each frame with the number of frames so far.
    """
    start_s, duration_s = span_s
    duration_s = _PART_S if duration_s is None else min(duration_s, _PART_S)
    recording = open_recording(
        video,
        focal_px=guesses[0].focal_px,
        start_s=start_s,
        duration_s=duration_s,
        folder_fps=folder_fps,
    )
    view = RoadEvidence(recording.camera)
    with closing(recording):
        view.add(recording.frames, detect, advance, has_horizon=False)
    return focal_posterior(
        guesses, view.scene, recording.size_px, sizes if isinstance(sizes, CuboidSizes) else None
    )


def _known_objects(
    objects: Sequence[KnownMetres], video: VideoName, camera: PinholeCamera, detect: Detect
) -> list[KnownObject]:
    """The measured objects with their classes; UsageError if the detector finds none in a box
    without a class.
    """
    known = []
    for metres in objects:
        name = metres.class_name or _detected_class(metres, video, camera, detect)
        if not name:
            raise UsageError(
                f"{metres.text}: expected the box of an object, but the detector finds none there; "
                f"correct the box, or add the class after the box: '{metres.text},van=...'."
            )
        known.append(
            KnownObject(
                name=metres.text,
                xyxy_px=metres.xyxy_px,
                size_class=SIZE_CLASSES.index(name),
                distance_m=metres.distance_m,
                height_m=metres.height_m,
                width_m=metres.width_m,
            )
        )
    return known


def _detected_class(
    metres: KnownMetres, video: VideoName, camera: PinholeCamera, detect: Detect
) -> str:
    """Class of the detection that overlaps most with a box; "" = none."""
    recording = open_recording(
        video, focal_px=camera.fx_px, start_s=max(metres.time_s - 0.02, 0), duration_s=_FRAME_S
    )
    with closing(recording):
        frame = next(recording.frames, None)
        if frame is None:
            return ""
        detections = detect(frame)
    if not len(detections):
        return ""
    overlap = iou(np.array([metres.xyxy_px]), detections.xyxy_px)[0]
    best = int(np.argmax(overlap))
    return SIZE_CLASSES[int(detections.class_id[best])] if overlap[best] >= _MIN_IOU else ""


def separability(
    fit: CameraFit, guesses: Sequence[FocalGuess], by_shape: FocalPosterior, *, has_height: bool
) -> tuple[str, ...]:
    """Sentences on focal length, camera height and pitch, alone and in pairs; `by_shape` is the
    prior of the fit.
    """
    camera, (shape_px, shape_sigma) = fit.camera, by_shape.guess
    origin = by_shape.as_guess(guesses).source
    focal = f"Focal length {camera.fx_px:.0f} px within {100 * fit.focal_sigma:.1f} %"
    sentences = []
    if fit.contradiction != 1.0:
        name, deviation = fit.largest_deviation
        sentences.append(
            f"Warning: the measurements contradict each other, or usual values: {name} is off by "
            f"{abs(deviation):.0f} sigma. All sigmas are {fit.contradiction:.1f} times as large; "
            "check boxes and metres."
        )
    if fit.gain("focal length") < _DETERMINED:
        sentences.append(
            f"{focal}, from the measurements; without them, {shape_px:.0f} px within "
            f"{100 * shape_sigma:.0f} %, from {origin}."
        )
    else:
        sentences.append(f"{focal}: the measurements do not determine it; it comes from {origin}.")
    height = f"Camera height {fit.height_m:.2f} ± {fit.height_sigma_m:.2f} m"
    if has_height:
        sentences.append(f"{height}, as measured.")
    elif fit.gain("camera height") < _DETERMINED:
        sentences.append(f"{height}, from the contact points of objects of known distance or size.")
    else:
        sentences.append(
            f"{height}: this is a usual height, since the measurements do not determine the "
            "height; give --camera-height-m."
        )
    pitch = (
        f"Pitch {math.degrees(fit.pitch_rad):+.1f} ± {math.degrees(fit.pitch_sigma_rad):.1f} "
        "degrees (positive = down)"
    )
    sentences.append(
        f"{pitch}." if fit.gain("horizon") < _DETERMINED else f"{pitch}: not determined."
    )
    if abs(fit.correlation("focal length", "camera height")) > _INSEPARABLE:
        sentences.append(
            "Focal length and camera height cannot be separated: their product is known within "
            f"{100 * fit.product_sigma:.1f} %. Measure the height of the camera, or a distance to "
            "an object of known height."
        )
    if abs(fit.correlation("camera height", "horizon")) > _INSEPARABLE:
        sentences.append(
            "Camera height and pitch cannot be separated: add a distance at least twice or at most "
            "half as long."
        )
    return tuple(sentences)
