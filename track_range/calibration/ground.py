"""The plane of the road of a camera that stands still, from points, lengths and lines that the user measured."""

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

import cv2
import numpy as np

from track_range.calibration.settings import GroundCalibrationSettings
from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import quoted
from track_range.foundation.files.output_files import write_bytes
from track_range.ranging.world.ground_file import GroundFile, save_ground
from track_range.ranging.world.road_plane import HEIGHT_SIGMA, RoadPlane
from track_range.ranging.world.road_plane_fit import PlaneMeasurements, PlanePriors, fit_plane
from track_range.recording.recording import Recording, open_recording
from track_range.recording.video.options import RecordingOptions

# relative standard deviations of a calibrated focal length, and of one that was only guessed
_CALIBRATED, _GUESSED = 0.005, 0.35
_PITCH_SIGMA_RAD = math.radians(2.0)  # of a measured pitch
_FLAGS = {"point": "--known-point", "length": "--known-length", "parallel": "--known-parallel"}
_FORMS = {"point": "X,Y=X_M,Y_M", "length": "X1,Y1,X2,Y2=METRES", "parallel": "X1,Y1,...,X4,Y4"}
_GRID_M, _GRID_LINES = 5.0, 12  # spacing of the picture's grid, and its lines to each side
_WHITE, _YELLOW, _RED = (255, 255, 255), (0, 220, 255), (40, 40, 255)


@dataclass(frozen=True, slots=True)
class GroundCalibration:
    """A fitted plane, and an image of the camera."""

    plane: RoadPlane
    measured: PlaneMeasurements
    image: Image  # undistorted
    calibrated_focal_px: float | None  # of the calibration of the images; None = none

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was determined, in words."""
        known, (along, across) = self.plane.summary(), self.plane.scale_sigma(self.measured.all_px)
        return (
            f"Camera {known['height_m']:.2f} ±{known['height_sigma_m']:.2f} m above the road, pitch "
            f"{known['pitch_deg']:.1f} ±{known['pitch_sigma_deg']:.1f} degrees down, roll "
            f"{known['roll_deg']:.1f} ±{known['roll_sigma_deg']:.1f}, focal length "
            f"{known['focal_px']:.0f} ±{known['focal_sigma_px']:.0f} px.",
            f"Lengths on the road are known to {100 * along:.1f} % along the view and "
            f"{100 * across:.1f} % across it, in the middle of what was given; speeds share this.",
        )

    def save(self, settings: GroundCalibrationSettings) -> list[str]:
        """Write the plane and the picture, and return their names; OutputError if one cannot be
        written.
        """
        save_ground(settings.out, GroundFile(self.plane, self.calibrated_focal_px))
        if settings.picture is None:
            return [str(settings.out)]
        _, encoded = cv2.imencode(".png", ground_picture(self.image, self.plane, self.measured))
        write_bytes(settings.picture, encoded.tobytes())
        return [str(settings.out), str(settings.picture)]


def calibrate_ground(settings: GroundCalibrationSettings) -> GroundCalibration:
    """The plane of the road in a video; nothing is written. UsageError for texts that are no
    measurements, or outside the image; GroundError, VideoError, RigError.
    """
    options = RecordingOptions(rig=settings.rig, focal_px=settings.focal_px, start_s=settings.at_s)
    with closing(open_recording(settings.recording, None, options)) as recording:
        frame = next(recording.frames, None)
        if frame is None:
            raise UsageError(f"{settings.recording}: expected an image at {settings.at_s:g} s.")
        calibration = recording.calibration
        measured = _measurements(settings, recording)
        is_guessed = calibration.kind == "estimated"
        sigma = _GUESSED if is_guessed else max(calibration.focal_sigma, _CALIBRATED)
        height_m, pitch_deg = settings.camera_height_m, settings.pitch_deg
        priors = PlanePriors(
            camera=calibration.camera,
            focal_sigma=sigma,
            height_m=None if height_m is None else (height_m, HEIGHT_SIGMA * height_m),
            pitch_rad=None if pitch_deg is None else (math.radians(pitch_deg), _PITCH_SIGMA_RAD),
        )
        focal_px = None if is_guessed else calibration.camera.fx_px
        return GroundCalibration(fit_plane(measured, priors), measured, frame.left, focal_px)


def _measurements(settings: GroundCalibrationSettings, recording: Recording) -> PlaneMeasurements:
    """The measurements of the settings, in px of the undistorted images."""
    points = [_numbers("point", text, 2, 2) for text in settings.known_point]
    lengths = [_numbers("length", text, 4, 1) for text in settings.known_length]
    lines = [_numbers("parallel", text, 8, 0) for text in settings.known_parallel]
    if not (points or lengths):
        raise UsageError(
            "calibrate ground: expected --known-point or --known-length, found neither: metres on "
            "the road give the scale."
        )
    if len(points) == 1:
        raise UsageError("--known-point: expected two or more points, found one; add another.")

    def pixels(rows: Sequence[FloatArray], n: int) -> FloatArray:
        xy_px = np.array([row[:n] for row in rows], np.float64).reshape(-1, 2)
        size_px = recording.calibration.rectifier.recorded_size_px
        if ((xy_px < -1) | (xy_px > size_px)).any():
            raise UsageError(
                "--known-point, --known-length, --known-parallel: expected pixels inside the video "
                f"of {size_px[0]}x{size_px[1]} px, found others."
            )
        boxes = np.concatenate([xy_px, xy_px], axis=1)
        return recording.calibration.rectifier.left_boxes(boxes)[:, :2]

    return PlaneMeasurements(
        point_px=pixels(points, 2),
        point_m=np.array([row[2:] for row in points], np.float64).reshape(-1, 2),
        length_px=pixels(lengths, 4).reshape(-1, 2, 2),
        length_m=np.array([row[4] for row in lengths], np.float64),
        parallel_px=pixels(lines, 8).reshape(-1, 4, 2),
        names=(*settings.known_point, *settings.known_length, *settings.known_parallel),
    )


def _numbers(kind: str, text: str, n_pixels: int, n_metres: int) -> FloatArray:
    """Pixels and metres of a text."""
    place, _, metres = text.partition("=")
    try:
        values = [float(part) for part in place.split(",")]
        values_m = [float(part) for part in metres.split(",")] if metres else []
    except ValueError:
        values, values_m = [], []
    is_valid = len(values) == n_pixels and len(values_m) == n_metres
    if not is_valid or not np.isfinite(values + values_m).all():
        raise UsageError(f"{_FLAGS[kind]} {quoted(text)}: expected '{_FORMS[kind]}'.")
    if kind == "length" and not values_m[0] > 0:
        raise UsageError(f"{_FLAGS[kind]} {quoted(text)}: expected a length above 0 m.")
    return np.array(values + values_m)


def ground_picture(image: Image, plane: RoadPlane, measured: PlaneMeasurements) -> Image:
    """The image with a grid of 5 m on the road, the pixels that were given, and where the points of
    known places are by the fit.
    """
    canvas = image.copy()
    middle = np.nanmean(plane.on_road_m(measured.all_px), axis=0)
    middle = np.round(middle / _GRID_M) * _GRID_M
    steps = np.linspace(-_GRID_LINES, _GRID_LINES, 16 * _GRID_LINES + 1) * _GRID_M
    for axis in (0, 1):
        for number in range(-_GRID_LINES, _GRID_LINES + 1):
            line = np.zeros((len(steps), 3))
            line[:, axis] = middle[axis] + steps
            line[:, 1 - axis] = middle[1 - axis] + number * _GRID_M
            _draw_line(canvas, plane.pixels(line), _WHITE)
    for lines in (measured.length_px, measured.parallel_px.reshape(-1, 2, 2)):
        for ends in lines:
            _draw_line(canvas, ends, _YELLOW, width_px=2)
    places = np.concatenate([measured.point_m, np.zeros((len(measured.point_m), 1))], axis=1)
    if plane.is_mirrored:
        places[:, 1] *= -1
    for at_px, fitted_px in zip(measured.point_px, plane.pixels(places), strict=True):
        cv2.circle(canvas, np.rint(at_px).astype(int).tolist(), 6, _YELLOW, 2, cv2.LINE_AA)
        cv2.drawMarker(canvas, np.rint(fitted_px).astype(int).tolist(), _RED, cv2.MARKER_CROSS, 12)
    return canvas


def _draw_line(
    canvas: Image, xy_px: FloatArray, bgr: tuple[int, int, int], width_px: int = 1
) -> None:
    """Draw the parts of a line (N, 2) that are in the image."""
    height, width = canvas.shape[:2]
    near = (np.abs(xy_px - [width / 2, height / 2]) < [2 * width, 2 * height]).all(axis=1)
    for i in np.flatnonzero(near[1:] & near[:-1]).tolist():
        ends = np.rint(xy_px[i : i + 2]).astype(int).tolist()
        cv2.line(canvas, ends[0], ends[1], bgr, width_px, cv2.LINE_AA)
