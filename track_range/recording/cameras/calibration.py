"""Calibration: the camera models of a recording, and the rectification of its images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.ranging.fitting.camera.focal_evidence import best_guess, default_guess
from track_range.ranging.fitting.camera.measurements import FocalGuess
from track_range.recording.cameras.focal_sources import focal_guesses
from track_range.recording.cameras.uncalibrated import (
    ASSUMED_BASELINE_M,
    GIVEN_FOCAL_SIGMA,
    UncalibratedPair,
    focal_sentence,
)
from track_range.recording.inputs import Inputs
from track_range.recording.names import VideoName, files_of
from track_range.recording.pairs.auto_alignment import PairAlignment
from track_range.recording.reader import VideoReader
from track_range.stereo.alignment.right_view import RightView
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import ImageView
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.geometry.recorded_view import RecordedView
from track_range.stereo.geometry.rectification import Rectifier, Undistorter
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import check_camera, check_rig, fitted_to_size
from track_range.stereo.geometry.virtual_pinhole import field_of_view
from track_range.stereo.rig_formats.camera_info import camera_of, is_undistorted, rig_of
from track_range.stereo.rig_formats.reading import find_rig, left_from_reference_m, load_camera, load_rig, mounting_of

_MAX_HEIGHT_SIGMA = 0.05
"""Relative standard deviation of a fitted camera height up to which it is used as known."""

CalibrationKind = Literal["rig", "focal length", "estimated"]
"""Source of the metric scale: a file, a given focal length, or the sizes of road users."""


@dataclass(frozen=True, slots=True)
class LensView:
    """The part of a wide lens's field of view that its images are undistorted to.

    Attributes:
        fov_deg: horizontal field of view; None = that of the lens, up to 120 degrees.
        yaw_deg: direction of its axis, to the right of the camera's; 0 for pairs.
    """

    fov_deg: float | None = None
    yaw_deg: float = 0.0


WHOLE_VIEW = LensView()


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """The camera models of a recording's rectified images.

    Attributes:
        kind: source of the metric scale.
        camera: the left or only camera.
        rectifier: computes the rectified (one camera: undistorted) images.
        rig: the rectified pair; None = one camera, or a pair without calibration.
        raw_rig: the pair as loaded.
        raw_camera: the left or only camera as loaded; None = as recorded images are.
        view: the part of the field of view of wide lenses to which their images are undistorted.
        path: the calibration file; None = a focal length.
        left_from_reference_m: (3,) translation of labels from the rig's reference camera to the left camera's frame.
        file_notes: messages for the user about the file.
        search_notes: the sentence that names the file if it was not given but found.
        alignment: disparity correction of a calibrated pair.
        uncalibrated: assumptions about a pair without calibration.
        guesses: guesses of a focal length that is not known; empty = it is.
        focal: estimate of a focal length that is not known; None = it is.
        mounting: height and pitch of a camera that was calibrated from the road, and the uncertainty of its focal
            length; None = unknown.
    """

    kind: CalibrationKind
    camera: PinholeCamera
    rectifier: Rectifier | Undistorter
    rig: StereoRig | None = None
    raw_rig: StereoRig | None = None
    raw_camera: PinholeCamera | None = None
    view: LensView = WHOLE_VIEW
    path: Path | None = None
    left_from_reference_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    file_notes: tuple[str, ...] = ()
    search_notes: tuple[str, ...] = ()
    alignment: PairAlignment | None = None
    uncalibrated: UncalibratedPair | None = None
    guesses: tuple[FocalGuess, ...] = ()
    focal: FocalGuess | None = None
    mounting: Mounting | None = None

    @property
    def focal_sigma(self) -> float:
        """Relative standard deviation of the focal length, which all distances share; 0 = calibrated."""
        if self.uncalibrated is not None:
            return self.uncalibrated.focal_sigma
        if self.focal is not None:
            return self.focal.sigma
        return 0.0 if self.mounting is None else self.mounting.focal_sigma

    @property
    def camera_height_m(self) -> float | None:
        """Height of the camera above the road in its calibration, if that determines it; None = unknown."""
        mounting = self.mounting
        if mounting is None or mounting.camera_height_sigma_m > _MAX_HEIGHT_SIGMA * mounting.camera_height_m:
            return None
        return mounting.camera_height_m

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user."""
        alignment = () if self.alignment is None else self.alignment.notes
        uncalibrated = () if self.uncalibrated is None else self.uncalibrated.notes
        return (*self.search_notes, *self.file_notes, *alignment, *uncalibrated, *self._focal_notes)

    @property
    def _focal_notes(self) -> tuple[str, ...]:
        """Message about the estimated focal length of one camera."""
        if self.uncalibrated is not None or self.focal is None:
            return ()
        return (
            f"No calibration: {focal_sentence(self.focal)}, and all distances share its error; a known distance "
            "reduces it: track-range calibrate --mono VIDEO --known-distance 'T_S,X1,Y1,X2,Y2=METRES' --out rig.yaml.",
        )

    @property
    def has_wide_lens(self) -> bool:
        """Whether the left or only camera has a wide lens."""
        return self.raw_camera is not None and self.raw_camera.is_wide

    @property
    def recorded_view(self) -> RecordedView | None:
        """The recorded image behind the undistorted left images of a wide lens; None for other lenses."""
        if self.raw_camera is None or not self.raw_camera.is_wide:
            return None
        return RecordedView(self.rectifier, (self.raw_camera.width_px, self.raw_camera.height_px))

    @property
    def rectified_boxes(self) -> Callable[[FloatArray], FloatArray]:
        """Function from boxes (N, 4) in pixels of the left video to boxes in pixels of its rectified images."""
        return self.rectifier.boxes if isinstance(self.rectifier, Undistorter) else self.rectifier.left_boxes

    def rectified(self, left: Image, right: Image | None) -> tuple[Image, ImageView | None]:
        """Rectify (one camera: undistort) the images of one time, (H, W, 3) uint8 as recorded."""
        if isinstance(self.rectifier, Undistorter):
            return self.rectifier.undistort(left), None
        if right is None:
            raise ValueError("right: the rectifier of a pair expects two images")
        return self.rectifier.rectify(left, right)

    def with_alignment(self, alignment: PairAlignment) -> Calibration:
        """A copy with the alignment of the pair; its right view and shift, if any, become part of the rectification."""
        rectifier, measured = self.rectifier, alignment.measured
        view = RightView.of(measured).if_needed(self.camera)
        shift_px = alignment.applied.shift_px
        if (view != RightView() or shift_px) and self.raw_rig is not None:
            rectifier = Rectifier(
                self.raw_rig,
                right_correction=view.matrix(self.camera),
                shift_px=shift_px,
                fov_deg=self.view.fov_deg,
                source=self.path or "the rig",
            )
        return replace(self, rectifier=rectifier, alignment=alignment)

    def with_row_offsets(self, row_offsets_px: list[float]) -> Calibration:
        """A copy with the row offsets of the first frames of an uncalibrated pair; an empty list = unknown."""
        if self.uncalibrated is None:
            return self
        pair = self.uncalibrated.with_row_offsets(row_offsets_px)
        rectifier = Rectifier(_assumed_rig(self.camera), row_offset_px=pair.row_offset_px)
        return replace(self, rectifier=rectifier, uncalibrated=pair)

    def with_focal_length(self, guess: FocalGuess) -> Calibration:
        """A copy of an uncalibrated camera or pair with another estimate of its focal length.

        The rectified images do not depend on it.
        """
        pair = None if self.uncalibrated is None else self.uncalibrated.with_focal_length(guess)
        size_px = self.camera.width_px, self.camera.height_px
        camera = PinholeCamera.of_focal_length(guess.focal_px, size_px)
        return replace(self, camera=camera, uncalibrated=pair, focal=guess)


def find_calibration(
    left: VideoName,
    inputs: Inputs,
    *,
    rig: Path | None,
    focal_px: float | None,
    view: LensView = WHOLE_VIEW,
) -> Calibration:
    """The calibration of opened videos: from the file `rig`, the focal length, the bag, or a file next to `left`.

    The first of these is used.

    Without any of these, the focal length is estimated, and the distances are uncalibrated. Images of wide lenses are
    undistorted to `view`.

    Raises:
        RigError: the file cannot be used or does not fit the images; or there is a field of view, but no wide lens.
        VideoError: the videos of an uncalibrated pair differ in size.
    """
    calibration = _found_calibration(left, inputs, rig, focal_px, view)
    if view != WHOLE_VIEW and not calibration.has_wide_lens:
        raise RigError(
            "--fov-deg, --yaw-deg: expected a calibration with a wide lens (kannala-brandt, double-sphere or omni), "
            "found a pinhole; omit these options."
        )
    return replace(calibration, view=view)


def _found_calibration(
    left: VideoName, inputs: Inputs, rig: Path | None, focal_px: float | None, view: LensView
) -> Calibration:
    if rig is None and focal_px is None and (in_bag := _calibration_in_bag(inputs, view)) is not None:
        return in_bag
    first_file = next(iter(files_of(left)), None) if rig is None and focal_px is None else None
    neighbour = None if first_file is None else find_rig(first_file)
    search_notes = () if neighbour is None else (f"Using calibration {neighbour} found next to the left video.",)
    path = neighbour if rig is None else rig
    if path is not None:
        load = _loaded_pair if inputs.pairs is not None else _loaded_camera
        loaded = load(path, inputs, view)
        return replace(loaded, search_notes=search_notes)
    guesses = () if focal_px is not None else _guesses(inputs)
    guess = best_guess(guesses) if focal_px is None else FocalGuess(focal_px, GIVEN_FOCAL_SIGMA, "--focal-px")
    camera = PinholeCamera.of_focal_length(guess.focal_px, inputs.size_px)
    check_camera(camera, "--focal-px" if focal_px is not None else f"{left}: focal length")
    focal = None if focal_px is not None else guess
    if inputs.pairs is not None:
        inputs.check_equal_sizes()
        return Calibration(
            kind="estimated",
            camera=camera,
            rectifier=Rectifier(_assumed_rig(camera)),
            uncalibrated=UncalibratedPair.of(inputs.size_px, guess, is_given=focal_px is not None),
            guesses=guesses,
            focal=focal,
        )
    kind: CalibrationKind = "focal length" if focal is None else "estimated"
    return Calibration(kind=kind, camera=camera, rectifier=Undistorter(camera), guesses=guesses, focal=focal)


def _guesses(inputs: Inputs) -> tuple[FocalGuess, ...]:
    """Guesses of the focal length from the header of the left video, or the usual one."""
    if isinstance(inputs.left, VideoReader):
        return focal_guesses(inputs.left)
    return (default_guess(inputs.size_px[0]),)


def _loaded_pair(path: Path, inputs: Inputs, view: LensView) -> Calibration:
    is_grey = inputs.left.is_grey
    raw_rig, notes = load_rig(path, size_px=inputs.size_px, right_size_px=inputs.right_size_px, is_grey=is_grey)
    rectifier = Rectifier(raw_rig, fov_deg=view.fov_deg, source=path)
    return Calibration(
        kind="rig",
        camera=rectifier.rig.left,
        rectifier=rectifier,
        rig=rectifier.rig,
        raw_rig=raw_rig,
        raw_camera=raw_rig.left,
        path=path,
        left_from_reference_m=left_from_reference_m(path, is_grey=is_grey, size_px=inputs.size_px),
        file_notes=(*notes, *_wide_notes(raw_rig.left, rectifier.rig.left, view)),
    )


def _calibration_in_bag(inputs: Inputs, view: LensView) -> Calibration | None:
    """The calibration of the cameras in the bag or bags of a recording; None = not (all) calibrated."""
    bags = [reader.bag for reader in inputs.readers if isinstance(reader, VideoReader) and reader.bag is not None]
    messages = [bag.camera for bag in bags if bag.camera is not None]
    if not messages or len(messages) < len(inputs.readers):
        return None
    path = bags[0].path.path
    is_rectified = all(bag.is_rectified or is_undistorted(message) for bag, message in zip(bags, messages, strict=True))
    if len(messages) == 1:
        camera, notes = fitted_to_size(camera_of(messages[0], path, is_rectified=is_rectified), inputs.size_px, path)
        check_camera(camera, path)
        return _of_camera(camera, path, notes, view)
    given = rig_of(messages[0], messages[1], path, is_rectified=is_rectified)
    check_rig(given, path)
    left, left_notes = fitted_to_size(given.left, inputs.size_px, f"{path} (left)")
    right, right_notes = fitted_to_size(given.right, inputs.right_size_px, f"{path} (right)")
    rig = StereoRig(left, right, given.right_from_left)
    rectifier = Rectifier(rig, fov_deg=view.fov_deg)
    return Calibration(
        kind="rig",
        camera=rectifier.rig.left,
        rectifier=rectifier,
        rig=rectifier.rig,
        raw_rig=rig,
        raw_camera=rig.left,
        path=path,
        file_notes=(*left_notes, *right_notes, *_wide_notes(rig.left, rectifier.rig.left, view)),
    )


def _loaded_camera(path: Path, inputs: Inputs, view: LensView) -> Calibration:
    is_grey = inputs.left.is_grey
    camera, notes = load_camera(path, size_px=inputs.size_px, is_grey=is_grey)
    shift_m = left_from_reference_m(path, is_grey=is_grey, size_px=inputs.size_px)
    loaded = _of_camera(camera, path, notes, view)
    return replace(loaded, left_from_reference_m=shift_m, mounting=mounting_of(path))


def _of_camera(camera: PinholeCamera, path: Path, notes: tuple[str, ...], view: LensView) -> Calibration:
    undistorter = Undistorter(camera, fov_deg=view.fov_deg, yaw_deg=view.yaw_deg)
    return Calibration(
        kind="rig",
        camera=undistorter.camera,
        rectifier=undistorter,
        raw_camera=camera,
        path=path,
        file_notes=(*notes, *_wide_notes(camera, undistorter.camera, view)),
    )


def _wide_notes(recorded: PinholeCamera, shown: PinholeCamera, view: LensView) -> tuple[str, ...]:
    """A note on the part of a wide lens's field of view that is measured."""
    if not recorded.is_wide:
        return ()
    lens, part = field_of_view(recorded), field_of_view(shown)
    direction = f", {view.yaw_deg:+g} degrees to the right of its axis" if view.yaw_deg else ""
    return (
        f"The lens sees {lens.horizontal_deg:.0f} x {lens.vertical_deg:.0f} degrees; its images are undistorted to "
        f"{part.horizontal_deg:.0f} x {part.vertical_deg:.0f} degrees{direction}, {shown.width_px}x{shown.height_px} "
        "px (--fov-deg, --views); the rest is not measured.",
    )


def _assumed_rig(camera: PinholeCamera) -> StereoRig:
    """Two cameras of this model at an assumed baseline, which does not affect the rectification."""
    return StereoRig.rectified(camera, ASSUMED_BASELINE_M)
