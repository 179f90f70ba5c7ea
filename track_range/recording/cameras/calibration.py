"""RecordingCalibration: the camera models of a recording, and the rectification of its images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from track_range.foundation.arrays import FloatArray, FloatArray32, Image
from track_range.foundation.errors import Note
from track_range.foundation.files.input_files import alternatives
from track_range.recording.cameras.auto_alignment import PairAlignment
from track_range.recording.cameras.camera_estimate import CameraEstimate
from track_range.recording.cameras.focal_sources import focal_guesses
from track_range.recording.cameras.known_lenses import UNKNOWN_LENS, GivenLens
from track_range.recording.sources.names import source_of
from track_range.recording.telemetry.companions import shared_note
from track_range.recording.video.frame import RecordedFrame, VideoError, VideoFrame
from track_range.recording.video.source_name import SourceName
from track_range.recording.video.utc import UtcStart
from track_range.recording.video.video import Video
from track_range.stereo.alignment.right_view import RightView
from track_range.stereo.geometry import image_size, size_notes
from track_range.stereo.geometry.camera import (
    PinholeCamera,
    pixel_aspect_of,
    shown_size,
    square_size,
)
from track_range.stereo.geometry.focal_guess import FocalGuess, best_guess, default_guess
from track_range.stereo.geometry.frames import Frame, ImageView
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.geometry.rectification import Rectifier, Undistorter
from track_range.stereo.geometry.rig import RigAccuracy, RigError, RoadCalibration, StereoRig
from track_range.stereo.geometry.rig_checks import RigCalibration, check_camera, check_rig
from track_range.stereo.geometry.virtual_pinhole import field_of_view
from track_range.stereo.lenses.registry import wide_lenses
from track_range.stereo.rig_formats.camera_info import camera_of, is_undistorted, rig_of
from track_range.stereo.rig_formats.reading import find_rig, load_camera, load_rig, read_calibration

# relative standard deviation of a focal length given by the user; assumed
_GIVEN_FOCAL_SIGMA = 0.02
# baseline of a pair without a rig, and the standard deviation of its logarithm: from 0.06 m, of a
# stereo camera in one housing, to both ends of a roof
_ASSUMED_BASELINE_M, _BASELINE_SIGMA = 0.5, 1.0
# relative standard deviation of a fitted camera height up to which it is used as known
# of a calibrated principal point, and of the image centre over the image width: those of cameras
_CENTRE_SIGMA_PX, _CENTRE_SIGMA = 2.0, 0.015
_MAX_HEIGHT_SIGMA = 0.05
# tolerated difference in size of left and right: codecs need even sizes, so one may lack a row
_CODEC_CROP_PX = 2

_MAX_ASPECT_ERROR = 0.1  # largest relative difference of pixel aspects that is not worth a note

# (width, height) of recorded images: of the left or only camera, of the right one
Sizes = tuple[tuple[int, int], ...]
# a file, a given length, or the sizes of road users
CalibrationKind = Literal["rig", "focal length", "estimated"]


@dataclass(frozen=True, slots=True)
class LensView:
    """The part of a wide lens's field of view that its images are undistorted to."""

    # horizontal field of view; None = that of the lens, up to 120 degrees
    fov_deg: float | None = None
    yaw_deg: float = 0.0  # direction of its axis, to the right of the camera's; 0 for pairs


WHOLE_VIEW = LensView()


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingCalibration:
    """The camera models of a recording's rectified images."""

    kind: CalibrationKind
    camera: PinholeCamera  # the left or only camera
    rectifier: Rectifier | Undistorter  # computes the rectified (one camera: undistorted) images
    # (width, height) of the left or only recorded images, and of the right ones; larger ones are
    # cropped
    sizes_px: Sizes
    # the rectified pair with its alignment, without a calibration an assumed one; None = one camera,
    # or a pair whose images do not match
    rig: StereoRig | None = None
    raw_rig: StereoRig | None = None  # the pair as loaded, or as assumed
    # the left or only camera as loaded; None = as recorded images are
    raw_camera: PinholeCamera | None = None
    view: LensView = WHOLE_VIEW
    path: Path | None = None  # the calibration file; None = a focal length
    # (3,) translation of labels from the rig's reference camera to the left camera's frame
    left_from_reference_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    file_notes: tuple[str, ...] = ()  # messages for the user about the file
    # the sentence that names the file if it was not given but found
    search_notes: tuple[str, ...] = ()
    alignment: PairAlignment | None = None  # disparity correction of a pair
    # guesses of a focal length that is not known; empty = it is
    guesses: tuple[FocalGuess, ...] = ()
    # estimate of a focal length that is not known exactly; None = it is
    focal: FocalGuess | None = None
    # evidence of the focal length, from a pass over the recording; None = there was none
    estimate: CameraEstimate | None = None
    # height, pitch and uncertainty of the focal length of a camera that was calibrated from the
    # road; None = unknown
    road: RoadCalibration | None = None
    # where the left or only camera is in its vehicle, and where it looks; None = unknown
    mounting: Mounting | None = None
    mounting_source: Literal["rig", "images"] = "rig"  # of a mounting that is known
    accuracy: RigAccuracy | None = None  # of a calibration with a board; None = unknown
    # other readings of the calibration or focal length
    alternatives: tuple[image_size.FocalAlternative, ...] = ()
    pixel_aspect: float = 1.0  # width / height of the recorded pixels, by the video
    has_depth: bool = False  # whether the recording contains depth of the left images

    @property
    def focal_sigma(self) -> float:
        """Relative standard deviation of the focal length, which all distances share; 0 = without
        alternatives.
        """
        if self.focal is not None:
            return self.focal.sigma
        largest = max((abs(1 - 1 / other.factor) for other in self.alternatives), default=0.0)
        return math.hypot(largest, 0.0 if self.road is None else self.road.focal_sigma)

    @property
    def scale_sigma(self) -> float:
        """Relative standard deviation that all distances share: of the focal length, and of a
        board's calibration.
        """
        known = self.accuracy
        board = (
            0.0
            if known is None
            else known.focal_sigma
            if len(self.sizes_px) == 1
            else known.scale_sigma
        )
        return math.hypot(self.focal_sigma, board)

    @property
    def centre_sigma_px(self) -> float:
        """Standard deviation of the principal point: measured, or taken to be the image centre."""
        cameras = (
            self.raw_camera,
            None if self.raw_rig is None else self.raw_rig.left,
            self.camera,
        )
        camera = next(camera for camera in cameras if camera is not None)
        centre = PinholeCamera.of_focal_length(1.0, camera.size_px)
        if (camera.cx_px, camera.cy_px) == (centre.cx_px, centre.cy_px):
            return _CENTRE_SIGMA * self.camera.width_px
        return _CENTRE_SIGMA_PX

    def view_mounting(self, given: Mounting | None = None) -> Mounting | None:
        """How the view is mounted, to which the images are rectified: its direction is that of the
        camera as given, else as in the file, turned by the view; None = it is not known.

        A lens whose view is turned is taken to look ahead itself, if its mounting is not known.
        """
        mounting = given or self.mounting
        if self.view.yaw_deg:
            return (mounting or Mounting()).turned(self.view.yaw_deg)
        return mounting

    def mounting_summary(self, given: Mounting | None) -> dict[str, Any]:
        """Section `mounting` of summary.json: that of the view, with the camera as `given`."""
        mounting = self.view_mounting(given) or Mounting()
        is_known = given is not None or self.mounting is not None
        return {
            "yaw_deg": round(mounting.yaw_deg, 2),
            "pitch_deg": round(mounting.pitch_deg, 2),
            "roll_deg": round(mounting.roll_deg, 2),
            "sigma_deg": round(mounting.sigma_deg, 2) if is_known else None,
            **({"x_m": mounting.x_m, "y_m": mounting.y_m} if is_known else {}),
            **({"z_m": mounting.z_m} if mounting.z_m is not None else {}),
            **({"front_m": mounting.front_m} if mounting.front_m is not None else {}),
            "source": "given" if given else self.mounting_source if is_known else "assumed",
        }

    @property
    def camera_height_m(self) -> float | None:
        """Height of the camera above the road in its calibration, if the calibration has it; None =
        unknown.
        """
        road = self.road
        if road is None or road.camera_height_sigma_m > _MAX_HEIGHT_SIGMA * road.camera_height_m:
            return None
        return road.camera_height_m

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user on the calibration, its alignment and the focal length."""
        alignment = () if self.alignment is None else self.alignment.notes
        focal = () if self.focal is None else self._focal_notes(self.focal)
        focal = tuple(Note(text, "uncalibrated", "warning", "calibration") for text in focal)
        return (*self.search_notes, *self.file_notes, *self._pixel_notes(), *alignment, *focal)

    def _pixel_notes(self) -> tuple[str, ...]:
        """A note on images whose pixels are not square according to the calibration or the
        video.
        """
        recorded = self.raw_camera or self.camera
        own, aspect = recorded.fy_px / recorded.fx_px, self.pixel_aspect
        is_contradicted = aspect != 1.0 and abs(own / aspect - 1.0) > _MAX_ASPECT_ERROR
        if not is_contradicted and (recorded.has_square_pixels or recorded.is_wide):
            return ()
        doubt = (
            f" According to the video, they are {aspect:.3g} times as wide as high; check the "
            "calibration."
            if is_contradicted
            else ""
        )
        return (
            f"Pixels of the images of {recorded.width_px}x{recorded.height_px} px are {own:.3g} "
            "times as wide as high: they are resampled to "
            f"{self.camera.width_px}x{self.camera.height_px} px with square pixels, to which focal "
            f"length and boxes refer.{doubt}",
        )

    @property
    def estimate_notes(self) -> tuple[str, ...]:
        """Messages for the user on an estimated camera: how well it is known, from what, and what
        would help most.
        """
        if self.estimate is None:
            return ()
        # the scale of a pair has its own note
        effect = "All distances share its error. " if len(self.sizes_px) == 1 else ""
        how = "Give --focal-px to replace it."
        if self.estimate.leading.kind == "usual":
            how = "Give --focal-px, or the field of view on the box (--lens-fov-deg 140d)."
        return (f"{self.estimate.sentence} {effect}{how}", *self.estimate.advice)

    def _focal_notes(self, focal: FocalGuess) -> tuple[str, ...]:
        of_estimate = self.estimate_notes
        if len(self.sizes_px) == 1 and of_estimate:
            return of_estimate
        length = (
            f"the focal length is estimated as {focal.focal_px:.0f} px within "
            f"{100 * focal.sigma:.0f} %, from {focal.source}"
        )
        if len(self.sizes_px) == 1:
            return (
                f"No calibration: {length}; all distances share its error, which the drive reduces. "
                "Give --focal-px, the field of view on the camera's box (--lens-fov-deg 140d), or a "
                "recorded drive: track-range calibrate drive VIDEO --out rig.yaml.",
            )
        if not self.guesses:
            length = f"the focal length is {focal.focal_px:.0f} px as given"
        if of_estimate:
            length = "the focal length is estimated, see below"
        how = (
            "for calibrated distances record a chessboard with both cameras, run `track-range "
            "calibrate --stereo LEFT RIGHT --board 9x6 --square-mm MM --out rig.yaml`, and give "
            "--rig rig.yaml"
        )
        if self.rig is None:
            return (
                f"No rig, so distances are uncalibrated: {length}; {how}.",
                "Matching points of left and right are not in equal rows, so stereo matching needs "
                "a rig: distances come from the left video alone.",
                *of_estimate,
            )
        return (
            f"No rig, so distances are uncalibrated: {length}, and the baseline is estimated from "
            f"the drive; {how}.",
            *of_estimate,
        )

    @property
    def has_wide_lens(self) -> bool:
        """Whether the left or only camera has a wide lens."""
        return self.raw_camera is not None and self.raw_camera.is_wide

    @property
    def recorded_view(self) -> Rectifier | Undistorter | None:
        """Undistorter of the left images of a wide lens, for drawing in recorded images; None for
        other lenses.
        """
        return self.rectifier if self.has_wide_lens else None

    def recorded(
        self,
        left: VideoFrame,
        right: VideoFrame | None,
        first_s: float,
        start: UtcStart | None = None,
    ) -> RecordedFrame:
        """The images of one time, cropped to `sizes_px`.

        `first_s` is the file time of the left video's first frame, and `start` its UTC; None =
        unknown.
        """
        images = (left.image,) if right is None else (left.image, right.image)
        cropped = tuple(
            image[:height_px, :width_px]
            for image, (width_px, height_px) in zip(images, self.sizes_px, strict=True)
        )
        time_s = left.time_s - first_s
        utc_s = math.nan if start is None else start.start_s + time_s
        return RecordedFrame(left.index, time_s, cropped, utc_s)

    def rectified(self, recorded: RecordedFrame) -> Frame:
        """Images of `sizes_px`, rectified (one camera: undistorted)."""
        left: Image
        right: ImageView | None
        if isinstance(self.rectifier, Undistorter):
            left, right = self.rectifier.undistort(recorded.images[0]), None
        else:
            left, right = self.rectifier.rectify(recorded.images[0], recorded.images[1])
        return Frame(
            index=recorded.index,
            time_s=recorded.time_s,
            left=left,
            right=right,
            utc_s=recorded.utc_s,
            recorded=recorded.images[0] if self.has_wide_lens else None,
        )

    def with_depth(self, frame: Frame, depth_m: FloatArray32 | None, left: Video) -> Frame:
        """A frame with the depth (h, w) in m that was recorded of its left image, of the video
        `left`; None = there is none.
        """
        if depth_m is None:
            return frame
        width_px, height_px = self.sizes_px[0]
        h, w = depth_m.shape
        # of the images that are cropped to the same size
        shown = depth_m[
            : round(h * height_px / left.height_px), : round(w * width_px / left.width_px)
        ]
        return replace(frame, depth_m=self.rectifier.left_depth(shown, self.camera.size_px))

    def with_alignment(self, alignment: PairAlignment) -> RecordingCalibration:
        """A copy with the alignment of the pair; its right view and shift, if any, become part of
        the rectification.
        """
        rectifier, measured = self.rectifier, alignment.measured
        view = RightView.of(measured).if_needed(self.camera)
        shift_px = alignment.applied.shift_px
        if (view != RightView() or shift_px) and self.raw_rig is not None:
            rectifier = Rectifier(
                self.raw_rig,
                right_correction=view.matrix(self.camera),
                shift_px=shift_px,
                is_turned=rectifier.is_turned,
                fov_deg=self.view.fov_deg,
                source=self.path or "the rig",
            )
        rig = None if self.rig is None else replace(self.rig, alignment=alignment.of_frames)
        return replace(self, rig=rig, rectifier=rectifier, alignment=alignment)

    def turned(self) -> RecordingCalibration:
        """A copy for videos that are both turned by 180 degrees against the rig."""
        if self.raw_rig is None:
            return self
        rectifier = Rectifier(
            self.raw_rig, fov_deg=self.view.fov_deg, is_turned=True, source=self.path or "the rig"
        )
        return replace(self, rectifier=rectifier)

    def with_estimate(self, estimate: CameraEstimate) -> RecordingCalibration:
        """An uncalibrated recording with an estimated camera; one camera is undistorted."""
        camera = self.camera.with_focal_length(estimate.focal_px)
        calibration = replace(
            self,
            camera=camera,
            rig=None if self.rig is None else replace(self.rig, left=camera, right=camera),
            focal=estimate.guess,
            estimate=estimate,
        )
        if not estimate.distortion or not isinstance(self.rectifier, Undistorter):
            return calibration
        stored = (self.raw_camera or self.camera).with_focal_length(estimate.focal_px)
        lens = replace(stored, distortion=estimate.distortion)
        undistorter = Undistorter(lens)
        return replace(
            calibration, raw_camera=lens, rectifier=undistorter, camera=undistorter.camera
        )


def find_calibration(
    left: SourceName,
    videos: Sequence[Video],
    *,
    rig: Path | StereoRig | None,
    focal_px: float | None,
    view: LensView = WHOLE_VIEW,
    cameras: Sequence[str] = (),
    lens: GivenLens = UNKNOWN_LENS,
) -> RecordingCalibration:
    """The calibration of one or two opened videos, left first.

    It comes from `rig`, a file, of which `cameras` may choose, or a model of the cameras, the focal
    length, the bag, or a file next to `left`; the first of these is used. Otherwise the focal
    length is estimated, from the stated `lens` or the header, and the distances are uncalibrated.
    Images of wide lenses are undistorted to `view`.

    Raises RigError if the file cannot be used or does not fit the images, or there is a field of
    view but no wide lens, and VideoError if the videos of an uncalibrated pair differ in size.
    """
    # cropped to a common size if only rows or columns of a codec differ
    sizes_px: Sizes = tuple((video.width_px, video.height_px) for video in videos)
    if all(abs(a - b) <= _CODEC_CROP_PX for a, b in zip(sizes_px[0], sizes_px[-1], strict=True)):
        sizes_px = ((min(w for w, _ in sizes_px), min(h for _, h in sizes_px)),) * len(sizes_px)
    if isinstance(rig, StereoRig):
        _check_no_names(cameras)
        _check_no_lens(lens, "the given rig")
        aspect = _pixel_aspect(videos, rig.left)
        return replace(_of_models(rig, None, sizes_px, view, aspect), pixel_aspect=aspect)
    path, search_notes = rig, tuple[str, ...]()
    if rig is None and focal_px is None:
        in_bag = None if cameras else _calibration_in_bag(videos, sizes_px, view)
        if in_bag is not None:
            _check_no_lens(lens, f"the calibration in {left}")
            return in_bag
        first_file = next(iter(left.files), None)
        path = None if first_file is None else find_rig(first_file)
        if path is not None:
            own = [*left.files, *(Path(str(video.path)) for video in videos)]
            shared = shared_note(path, own)
            search_notes = (f"Using calibration {path} found next to the left video.{shared}",)
    if path is not None:
        _check_no_lens(lens, path)
        chosen = _Chosen(path, tuple(cameras), videos[0].is_grey)
        content = chosen.content(sizes_px)
        aspect = _pixel_aspect(videos, content.left)
        loaded = _loaded(chosen, content, sizes_px, view, aspect=aspect)
        return replace(loaded, search_notes=search_notes, pixel_aspect=aspect)
    _check_no_names(cameras)
    _check_view(None, view)
    aspect, notes = _pixel_aspect(videos), tuple[str, ...]()
    if focal_px is None and any(video.camera is not None for video in videos):
        focal_px, note = _one_focal_length(videos, sizes_px, aspect)
        notes = (note,)
    calibration = _without_file(left, videos, sizes_px, focal_px, aspect, lens)
    return replace(calibration, search_notes=(*calibration.search_notes, *notes))


def _check_no_names(names: Sequence[str]) -> None:
    """Raise RigError for names of cameras without a calibration file that has them."""
    if names:
        raise RigError(
            f"--camera {','.join(names)}: expected a calibration file with cameras of these names, "
            "found none; give --rig FILE, or omit the option."
        )


def names_of(camera: str | Sequence[str]) -> tuple[str, ...]:
    """The names of an option, in a list or separated by commas."""
    names = camera.split(",") if isinstance(camera, str) else camera
    return tuple(name.strip() for name in names if name.strip())


@dataclass(frozen=True, slots=True)
class _Chosen:
    """A calibration file and the cameras that were chosen of it."""

    path: Path
    names: tuple[str, ...] = ()
    is_grey: bool = False

    def content(self, sizes_px: Sizes) -> RigCalibration:
        """Content of the file for images of these sizes."""
        return read_calibration(
            self.path,
            is_grey=self.is_grey,
            is_pair=len(sizes_px) > 1,
            cameras=self.names,
            size_px=sizes_px[0],
        )


def _pixel_aspect(videos: Sequence[Video], camera: PinholeCamera | None = None) -> float:
    """Width / height of the pixels as the video states, for two images in one from the size of a
    camera's images.
    """
    if camera is not None and camera.width_px:
        for video in videos:
            video.with_packed_pixels(camera.width_px / camera.height_px)
    return pixel_aspect_of((videos[0].width_px, videos[0].height_px), videos[0].pixel_aspect)


def calibration_of(
    cameras: Path | StereoRig | PinholeCamera | None,
    sizes_px: Sizes,
    view: LensView = WHOLE_VIEW,
    names: Sequence[str] = (),
    lens: GivenLens = UNKNOWN_LENS,
) -> RecordingCalibration:
    """The calibration of one camera or a pair, for images of one or two sizes, from a file, of
    which `names` may choose cameras, or from camera models; None = the focal length of the stated
    lens or a usual one, and an assumed baseline, which the drive corrects.

    Raises RigError if the file cannot be used, the cameras do not fit the images, or as
    `find_calibration`.
    """
    if isinstance(cameras, Path):
        chosen = _Chosen(cameras, tuple(names))
        _check_no_lens(lens, cameras)
        return _loaded(chosen, chosen.content(sizes_px), sizes_px, view)
    _check_no_names(names)
    if cameras is None:
        if sizes_px[0] != sizes_px[-1]:
            (lw, lh), (rw, rh) = sizes_px
            raise RigError(
                f"rig: expected right images of {lw}x{lh} px like the left ones, found "
                f"{rw}x{rh} px; different cameras require the calibration of both."
            )
        _check_view(None, view)
        guesses = lens.guesses(sizes_px[0]) or (default_guess(sizes_px[0]),)
        guess = best_guess(guesses)
        return _assumed(
            PinholeCamera.of_focal_length(guess.focal_px, sizes_px[0]), sizes_px, guess, guesses
        )
    _check_no_lens(lens, "the given cameras")
    return _of_models(cameras, None, sizes_px, view)


def _check_no_lens(lens: GivenLens, calibration: object) -> None:
    if lens:
        raise RigError(
            "--lens-fov-deg, --camera-model: expected a camera without a calibration, found "
            f"{calibration}, which knows its focal length; omit these options."
        )


def _check_view(camera: PinholeCamera | None, view: LensView) -> None:
    if view != WHOLE_VIEW and not (camera is not None and camera.is_wide):
        raise RigError(
            "--fov-deg, --yaw-deg: expected a calibration with a wide lens "
            f"({alternatives(wide_lenses())}), found a pinhole; omit these options."
        )


def _without_file(
    left: SourceName,
    videos: Sequence[Video],
    sizes_px: Sizes,
    focal_px: float | None,
    aspect: float,
    lens: GivenLens,
) -> RecordingCalibration:
    """One camera or a pair with a given focal length, or an estimate from the stated lens or the
    header of the left video.
    """
    video, shown_px = videos[0], shown_size(sizes_px[0], aspect)
    stated = focal_guesses(video, lens)
    guesses = stated if focal_px is None else ()
    guess = (
        best_guess(guesses)
        if focal_px is None
        else FocalGuess(focal_px, _GIVEN_FOCAL_SIGMA, "--focal-px")
    )
    stored = PinholeCamera.of_pixel_aspect(guess.focal_px, sizes_px[0], aspect)
    camera = stored.squared()
    source = "--focal-px" if focal_px is not None else f"{left}: focal length"
    check_camera(camera, source)
    contradictions = [
        f"--focal-px: {guess.focal_px:.0f} px was given, but {other.source} means "
        f"{other.focal_px:.0f} px within {100 * other.sigma:.0f} %; all distances scale with the "
        "focal length, so check which of the two is right."
        for other in stated
        if focal_px is not None
        and other != default_guess(shown_px)
        and abs(math.log(guess.focal_px / other.focal_px)) > 3 * other.sigma
    ]
    if sizes_px[0] != sizes_px[-1]:
        (lw, lh), (rw, rh) = sizes_px
        raise VideoError(
            f"{videos[1].path}: expected {lw}x{lh} px like {videos[0].path}, got {rw}x{rh}; "
            "different cameras require --rig with the calibration of both."
        )
    others = () if video.pixel_aspect is not None else image_size.analogue_alternatives(sizes_px[0])
    doubt = (
        f"{video.path}: pixel aspect of analogue video is not stated: "
        f"{', '.join(other.cause for other in others)}. Pixels are taken as square, and sigma "
        "covers it; state the shape: ffmpeg -i IN -c copy -aspect 4:3 OUT.mp4."
    )
    return replace(
        _assumed(stored, sizes_px, guess, guesses),
        alternatives=others,
        pixel_aspect=aspect,
        file_notes=(
            *size_notes.field_notes(camera, source),
            *contradictions,
            *([doubt] if others else []),
        ),
    )


def _assumed(
    stored: PinholeCamera, sizes_px: Sizes, focal: FocalGuess, guesses: tuple[FocalGuess, ...]
) -> RecordingCalibration:
    """One camera, or two alike with an assumed baseline, with a focal length of these guesses;
    without guesses, it is given.
    """
    is_exact = not guesses and len(sizes_px) == 1
    calibration = RecordingCalibration(
        kind="focal length" if is_exact else "estimated",
        camera=stored.squared(),
        rectifier=Undistorter(stored),
        sizes_px=sizes_px,
        raw_camera=stored,
        guesses=guesses,
        focal=None if is_exact else focal,
    )
    if len(sizes_px) == 1:
        return calibration
    rig = replace(StereoRig.rectified(stored, _ASSUMED_BASELINE_M), baseline_sigma=_BASELINE_SIGMA)
    pair = Rectifier(rig)
    return replace(calibration, rectifier=pair, rig=pair.rig, raw_rig=rig)


def _sizes_of(camera: PinholeCamera, sizes_px: Sizes, aspect: float) -> Sizes:
    """Sizes of the images as a calibration has them: stored, or with square pixels if these fit it
    better.
    """
    candidates: list[Sizes] = [
        sizes_px,
        tuple(square_size(size_px, aspect) for size_px in sizes_px),
    ]
    if not camera.width_px:
        return min(candidates, key=lambda sizes: abs((camera.cx_px + 0.5) / sizes[0][0] - 0.5))
    own = camera.width_px / camera.height_px
    return min(candidates, key=lambda sizes: abs(math.log(own * sizes[0][1] / sizes[0][0])))


def _loaded(
    chosen: _Chosen,
    content: RigCalibration,
    sizes_px: Sizes,
    view: LensView,
    *,
    aspect: float = 1.0,
) -> RecordingCalibration:
    path, names, is_grey = chosen.path, chosen.names, chosen.is_grey
    fitted_px = _sizes_of(content.left, sizes_px, aspect)
    cameras: StereoRig | PinholeCamera
    if len(sizes_px) > 1:
        cameras, notes = load_rig(
            path,
            size_px=fitted_px[0],
            right_size_px=fitted_px[1],
            is_grey=is_grey,
            cameras=names,
        )
    else:
        cameras, notes = load_camera(path, size_px=fitted_px[0], is_grey=is_grey, cameras=names)
    content = content.of_size(fitted_px[0])
    return replace(
        _of_cameras(cameras, path, notes, sizes_px, view),
        road=content.road if len(sizes_px) == 1 else None,
        mounting=content.mounting,
        accuracy=content.accuracy,
        left_from_reference_m=np.array(content.left_from_reference_m),
        alternatives=image_size.fit_to_size(content.left, fitted_px[0]).alternatives,
    )


def _one_focal_length(videos: Sequence[Video], sizes_px: Sizes, aspect: float) -> tuple[float, str]:
    """The focal length of the calibrated camera of two, px of images with square pixels, and a
    note.
    """
    number, video, message = next(
        (number, video, video.camera)
        for number, video in enumerate(videos)
        if video.camera is not None
    )
    is_rectified = video.is_rectified or is_undistorted(message)
    camera = camera_of(message, source_of(video.path).files[0], is_rectified=is_rectified)
    camera = camera.resized(sizes_px[number])
    focal_px = camera.resized(square_size(sizes_px[number], aspect)).fx_px
    unused = ", its distortion is not" if camera.is_distorted else ""
    return focal_px, (
        f"{videos[1 - number].path}: no calibration beside these images: only the focal length of "
        f"the other camera is used, {focal_px:.0f} px{unused}; record the camera_info of both, or "
        "give --rig."
    )


def _calibration_in_bag(
    videos: Sequence[Video], sizes_px: Sizes, view: LensView
) -> RecordingCalibration | None:
    """The calibration of the cameras in the bag or bags of a recording; None = not (all)
    calibrated.
    """
    messages = [video.camera for video in videos if video.camera is not None]
    if len(messages) < len(videos):
        return None
    path = source_of(videos[0].path).files[0]
    is_rectified = all(
        video.is_rectified or is_undistorted(message)
        for video, message in zip(videos, messages, strict=True)
    )
    cameras: StereoRig | PinholeCamera
    if len(messages) == 1:
        cameras = camera_of(messages[0], path, is_rectified=is_rectified)
    else:
        cameras = rig_of(messages[0], messages[1], path, is_rectified=is_rectified)
    return _of_models(cameras, path, sizes_px, view)


def _of_models(
    given: StereoRig | PinholeCamera,
    path: Path | None,
    sizes_px: Sizes,
    view: LensView,
    aspect: float = 1.0,
) -> RecordingCalibration:
    """The calibration of one camera (the left camera of a rig) or of a pair; `path` is the file
    with the models.
    """
    source = path or "rig"
    left = given.left if isinstance(given, StereoRig) else given
    fitted: StereoRig | PinholeCamera
    fitted_px = _sizes_of(left, sizes_px, aspect)
    if len(sizes_px) == 1:
        fitted, notes = size_notes.fitted_to_size(left, fitted_px[0], source)
        check_camera(fitted, source)
    elif isinstance(given, PinholeCamera):
        raise RigError(f"{source}: expected a rig of two cameras, found one camera.")
    else:
        check_rig(given, source)
        fitted, notes = size_notes.fitted_rig(given, (fitted_px[0], fitted_px[1]), source)
    accuracy = given.accuracy if isinstance(given, StereoRig) else None
    notes = notes if accuracy is None else (accuracy.sentence, *notes)
    loaded = _of_cameras(fitted, path, notes, sizes_px, view)
    return replace(
        loaded,
        accuracy=accuracy,
        alternatives=image_size.fit_to_size(left, fitted_px[0]).alternatives,
    )


def _of_cameras(
    cameras: StereoRig | PinholeCamera,
    path: Path | None,
    notes: tuple[str, ...],
    sizes_px: Sizes,
    view: LensView,
) -> RecordingCalibration:
    rig: StereoRig | None = None
    if isinstance(cameras, StereoRig):
        _check_view(cameras.left, view)
        left, right = cameras.left.resized(sizes_px[0]), cameras.right.resized(sizes_px[1])
        cameras = replace(cameras, left=left, right=right, alignment=None)
        pair = Rectifier(cameras, fov_deg=view.fov_deg, source=path or "rig")
        rectifier: Rectifier | Undistorter = pair
        rig, recorded, shown = pair.rig, cameras.left, pair.rig.left
    else:
        _check_view(cameras, view)
        cameras = cameras.resized(sizes_px[0])
        rectifier = Undistorter(cameras, fov_deg=view.fov_deg, yaw_deg=view.yaw_deg)
        recorded, shown = cameras, rectifier.camera
    if recorded.is_wide:
        lens, part = field_of_view(recorded), field_of_view(shown)
        direction = f", {view.yaw_deg:+g} degrees to the right of its axis" if view.yaw_deg else ""
        notes = (
            *notes,
            f"The lens sees {lens.horizontal_deg:.0f} x {lens.vertical_deg:.0f} degrees; its "
            f"images are undistorted to {part.horizontal_deg:.0f} x {part.vertical_deg:.0f} "
            f"degrees{direction}, {shown.width_px}x{shown.height_px} px (--fov-deg, --views); the "
            "rest is not measured.",
        )
    return RecordingCalibration(
        kind="rig",
        camera=shown,
        rectifier=rectifier,
        sizes_px=sizes_px,
        rig=rig,
        raw_rig=cameras if isinstance(cameras, StereoRig) else None,
        raw_camera=recorded,
        view=view,
        path=path,
        file_notes=notes,
    )
