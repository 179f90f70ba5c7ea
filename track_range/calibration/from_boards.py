"""Calibration of one camera or a pair from images of a board: rig file, residuals of the views,
picture.
"""

import contextlib
import io
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from track_range.calibration.board_images import board_images
from track_range.calibration.board_search import BoardSearch, find_views
from track_range.calibration.settings import CalibrationSettings
from track_range.foundation.errors import UsageError
from track_range.foundation.files.cache_folder import set_matplotlib_folder
from track_range.foundation.files.output_files import check_outputs, write_bytes, write_json
from track_range.foundation.progress import StepProgress, no_progress
from track_range.stereo.calibration.boards import Board, CalibrationError, board_of
from track_range.stereo.calibration.coverage import view_shape
from track_range.stereo.calibration.one_camera import (
    CameraCalibration,
    CameraModel,
    ViewFit,
    calibrate_camera,
    fit_camera,
    total_rms_px,
)
from track_range.stereo.calibration.two_cameras import PairCalibration, calibrate_pair
from track_range.stereo.geometry.rig import RigAccuracy
from track_range.stereo.geometry.virtual_pinhole import field_of_view
from track_range.stereo.lenses.lens import KANNALA_BRANDT, PINHOLE
from track_range.stereo.rig_formats.rig_yaml import save_camera, save_rig

# names of the lens models by value of --lens
LENS_NAMES = {"pinhole": PINHOLE, "fisheye": KANNALA_BRANDT}
# angle by which images may reach farther from the optical axis than the corners of the boards
_REACH_DEG = 5.0
# plausible range of the median distance of the board, m; outside, --square-mm is probably wrong
_BOARD_M = (0.1, 20.0)
_ARROW_FRACTION = 0.025  # arrow of the 90th percentile of the residuals / image width
_N_CELLS = 40  # cells along a row of the image in which corners are counted
_WIDE_DEG = 75.0  # field of view from which a fisheye is tried
# residual of a fisheye / of a pinhole below which the lens is wide; 0.95 to 1 of ordinary lenses
_BETTER = 0.7
# median edge width of the views, px, above which the images count as out of focus
_OUT_OF_FOCUS_PX = 6.0


@dataclass(frozen=True, slots=True)
class BoardCalibration:
    """A camera or a pair of cameras calibrated from images of a board."""

    search: BoardSearch
    result: CameraCalibration | PairCalibration
    figures: dict[str, Any]  # all measured values, as plain values for JSON

    @property
    def cameras(self) -> dict[str, CameraCalibration]:
        """The calibration of each camera, by name."""
        if isinstance(self.result, PairCalibration):
            return {"left": self.result.left, "right": self.result.right}
        return {"camera": self.result}

    @property
    def accuracy(self) -> RigAccuracy:
        """Relative standard deviations of focal length and scale."""
        camera, std = next((one.camera, one.std) for one in self.cameras.values())
        focal_sigma = max(std.fx_px / camera.fx_px, std.fy_px / camera.fy_px)
        scale_sigma = (
            self.result.scale_sigma if isinstance(self.result, PairCalibration) else focal_sigma
        )
        return RigAccuracy(
            focal_sigma=float(f"{focal_sigma:.3g}"), scale_sigma=float(f"{scale_sigma:.3g}")
        )

    @property
    def warnings(self) -> list[str]:
        """Warnings for the user about implausible results."""
        return list(self.figures["warnings"])

    def save(self, settings: CalibrationSettings) -> list[Path]:
        """Write the rig, the picture and perhaps the results, and return their paths; OutputError
        or RigError.
        """
        comments = [
            f"track-range calibrate: {len(self.result.fits)} views, residual "
            f"{self.result.rms_px:.3f} px RMS"
        ]
        if isinstance(self.result, PairCalibration):
            save_rig(self.result.rig, settings.out, comments=comments, accuracy=self.accuracy)
        else:
            save_camera(self.result.camera, settings.out, comments=comments, accuracy=self.accuracy)
        picture = picture_file(settings)
        write_bytes(picture, calibration_picture(self.cameras))
        write_json(settings.json_file, self.figures)
        return [file for file in (settings.out, picture, settings.json_file) if file is not None]


def calibrate(
    settings: CalibrationSettings, progress: StepProgress = no_progress
) -> BoardCalibration:
    """Find the board in the images and calibrate; nothing is written before
    `BoardCalibration.save`.

    Raises UsageError if there is not exactly one source, or the board is invalid, ImageFileError
    and VideoError if images cannot be read, CalibrationError if the views are not sufficient,
    OutputError if a result would overwrite an image.
    """
    return calibrate_views(find_boards(settings, progress), settings, progress)


def find_boards(settings: CalibrationSettings, progress: StepProgress = no_progress) -> BoardSearch:
    """Search the images for the board; the first part of `calibrate`."""
    images = board_images(_sources(settings), settings.stereo_layout)
    outputs = (settings.out, picture_file(settings), settings.json_file)
    board = _board(settings)
    check_outputs([file for file in outputs if file is not None], images.files)
    with progress("searching for boards") as advance:
        return find_views(images, board, advance)


def calibrate_views(
    search: BoardSearch, settings: CalibrationSettings, progress: StepProgress = no_progress
) -> BoardCalibration:
    """Calibrate from the views of the board; the second part of `calibrate`."""
    result: CameraCalibration | PairCalibration
    model: dict[str, Any] = {
        "n_distortion_coefficients": settings.lens_terms,
        "lens": LENS_NAMES[settings.lens],
    }
    with progress("calibrating") as advance:
        if settings.stereo is None:
            result = calibrate_camera([shot[0] for shot in search.shots], advance=advance, **model)
        else:
            result = calibrate_pair(
                [(shot[0], shot[1]) for shot in search.shots], advance=advance, **model
            )
    board, sources = _board(settings), list(_sources(settings))
    figures: dict[str, Any] = {
        "board": board.name,
        "square_mm": board.square_m * 1000,
        "sources": sources,
    }
    calibration = BoardCalibration(search, result, figures)
    figures |= _measured_figures(calibration)
    figures["warnings"] += _warnings(search, calibration.cameras)
    return calibration


def _measured_figures(calibration: BoardCalibration) -> dict[str, Any]:
    result, search, cameras = calibration.result, calibration.search, calibration.cameras
    figures: dict[str, Any] = {name: _camera_figures(camera) for name, camera in cameras.items()}
    if isinstance(result, PairCalibration):
        figures |= {
            "right_from_left": result.rig.right_from_left.tolist(),
            "baseline_m": result.rig.baseline_m,
            "baseline_sd_m": result.baseline_std_m,
            "scale_sigma": result.scale_sigma,
            "rms_px": result.rms_px,
            "single_rms_px": list(result.single_rms_px),
            "rows_px": result.row_error_px,
            "held_out_rows_px": result.held_out_row_error_px,
        }
        views = [
            {
                **_view_figures(fit.left),
                "right_name": fit.right.view.name,
                "right_rms_px": fit.right.rms_px,
                "rows_px": fit.row_error_px,
            }
            for fit in result.fits
        ]
        warnings = [
            f"{name}: {text}"
            for name, camera in cameras.items()
            for text in camera.coverage.warnings
        ]
    else:
        figures["rms_px"] = result.rms_px
        views = [_view_figures(fit) for fit in result.fits]
        warnings = list(result.coverage.warnings)
    rejected = [asdict(view) for view in (*search.rejected, *result.rejected)]
    return {
        **figures,
        "views": views,
        "rejected": rejected,
        "notes": search.notes,
        "warnings": warnings,
    }


def _camera_figures(calibration: CameraCalibration) -> dict[str, Any]:
    coverage = {
        key: value for key, value in asdict(calibration.coverage).items() if key != "warnings"
    }
    std = asdict(calibration.std)
    return {
        **asdict(calibration.camera),
        "sd": std,
        "rms_px": calibration.rms_px,
        "coverage": coverage,
    }


def _view_figures(fit: ViewFit) -> dict[str, Any]:
    x, y, size, skew = view_shape(fit.view).tolist()
    shape = {"x": x, "y": y, "size": size, "skew": skew, "tilt_deg": fit.tilt_deg}
    return {
        "name": fit.view.name,
        "rms_px": fit.rms_px,
        "edge_px": fit.view.edge_px,
        "n": len(fit.view.xy_px),
        **shape,
    }


def picture_file(settings: CalibrationSettings) -> Path:
    """Path of the picture of residuals and coverage."""
    return settings.picture or settings.out.parent / f"{settings.out.stem}.png"


def _sources(settings: CalibrationSettings) -> tuple[str, ...]:
    if (settings.mono is None) == (settings.stereo is None):
        raise UsageError(
            "expected one source of images; give --mono IMAGES or --stereo LEFT RIGHT."
        )
    return (settings.mono,) if settings.mono is not None else settings.stereo or ()


def _board(settings: CalibrationSettings) -> Board:
    if settings.board is None:
        raise UsageError(
            "expected --board, such as 9x6; without a board, give one camera with --mono."
        )
    try:
        return board_of(settings.board, settings.square_mm)
    except ValueError as error:
        raise UsageError(f"--board, --square-mm: {error}") from error


def _warnings(search: BoardSearch, cameras: Mapping[str, CameraCalibration]) -> list[str]:
    warnings = []
    first = next(iter(cameras.values()))
    distance_m = float(np.median([fit.board_to_camera[2, 3] for fit in first.fits]))
    if not _BOARD_M[0] <= distance_m <= _BOARD_M[1]:
        warnings.append(
            f"the median distance of the boards is {distance_m:.3g} m; check --square-mm."
        )
    if (
        float(np.median([view.edge_px for shot in search.shots for view in shot]))
        > _OUT_OF_FOCUS_PX
    ):
        warnings.append("most images are out of focus; focus and lock the lens before calibrating.")
    warnings += [
        text
        for name, calibration in cameras.items()
        for text in wide_lens_warnings(name, calibration)
    ]
    for name, calibration in cameras.items():
        # the corners determine a wide lens not as far from its axis as its images reach
        if not calibration.camera.is_wide:
            continue
        corners_px = np.concatenate([fit.view.xy_px for fit in calibration.fits])
        cosine = calibration.camera.recorded_rays(corners_px)[:, 2]
        reach_deg = float(np.degrees(np.nanmax(np.arccos(np.clip(cosine, -1, 1)))))
        image_deg = max(math.degrees(angle_rad) for angle_rad in field_of_view(calibration.camera))
        if image_deg > reach_deg + _REACH_DEG:
            warnings.append(
                f"{name}: the corners reach {reach_deg:.0f} degrees from the optical axis and the "
                f"image {image_deg:.0f} degrees: the lens model is extrapolated beyond the "
                "corners; show the board near the edges, and use at most --fov-deg "
                f"{2 * reach_deg:.0f}."
            )
    sizes = {f"{one.camera.width_px}x{one.camera.height_px} px" for one in cameras.values()}
    if len(sizes) > 1:
        warnings.append(
            f"images of the two cameras differ in size ({', '.join(sorted(sizes))}); a run needs "
            "videos of equal size."
        )
    return warnings


def wide_lens_warnings(name: str, calibration: CameraCalibration) -> Iterator[str]:
    """A warning if a fisheye, which has fewer terms, fits the views of a pinhole camera much
    better.
    """
    camera, views = calibration.camera, [fit.view for fit in calibration.fits]
    if (
        camera.is_wide
        or 2 * math.degrees(math.atan(camera.width_px / 2 / camera.fx_px)) < _WIDE_DEG
    ):
        return
    with contextlib.suppress(CalibrationError):
        fisheye, fits = fit_camera(views, CameraModel(lens=KANNALA_BRANDT))
        rms_px = total_rms_px(fits)
        if rms_px < _BETTER * calibration.rms_px:
            yield (
                f"{name}: the residual of the pinhole model is {calibration.rms_px:.2f} px RMS, "
                f"the residual of a fisheye {rms_px:.2f} px, with a focal length of "
                f"{fisheye.fx_px:.0f} instead of {camera.fx_px:.0f} px: the lens is wide; repeat "
                "with --lens fisheye."
            )


def calibration_picture(cameras: Mapping[str, CameraCalibration]) -> bytes:
    """A PNG file of coverage and residuals, with one row of panels per camera.

    left   the image plane: density of corners as shades, residuals as arrows, enlarged by the factor in the title
    right  one bar per view: its residual and name; the three worst are red
    """
    set_matplotlib_folder()
    from matplotlib.colors import PowerNorm  # matplotlib takes a third of a second
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 6.5 * len(cameras)), layout="constrained")
    panels = figure.subplots(len(cameras), 2, squeeze=False, width_ratios=(2, 1))
    for (plane, bars), (name, calibration) in zip(panels, cameras.items(), strict=True):
        fits, width_px, height_px = (
            calibration.fits,
            calibration.camera.width_px,
            calibration.camera.height_px,
        )
        xy_px = np.concatenate([fit.view.xy_px for fit in fits])
        residual_px = np.concatenate([fit.residual_px for fit in fits])
        view = np.repeat(np.arange(len(fits)), [len(fit.view.xy_px) for fit in fits])
        length_px = float(np.percentile(np.linalg.norm(residual_px, axis=1), 90))
        factor = _ARROW_FRACTION * width_px / max(length_px, 1e-6)
        edges = ((-0.5, width_px - 0.5), (-0.5, height_px - 0.5))
        cells = (_N_CELLS, max(_N_CELLS * height_px // width_px, 1))
        plane.hist2d(*xy_px.T, bins=cells, range=edges, cmap="GnBu", norm=PowerNorm(0.5), alpha=0.6)
        arrows: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.0012}
        plane.quiver(*xy_px.T, *(factor * residual_px).T, view, cmap="hsv", **arrows)
        title = (
            f"{name}: {len(fits)} views, residual {calibration.rms_px:.3f} px RMS; arrows x "
            f"{factor:.0f}"
        )
        plane.set(xlim=edges[0], ylim=edges[1][::-1], aspect="equal", title=title)
        rms_px = np.array([fit.rms_px for fit in fits])
        is_worst = np.argsort(np.argsort(-rms_px)) < 3
        drawn = bars.barh(
            np.arange(len(fits)), rms_px, color=np.where(is_worst, "#dc3c3c", "#3c82be")
        )
        bars.bar_label(drawn, fmt="%.2f", fontsize=7)
        # the font lacks some scripts
        names = [fit.view.name[-28:].encode("ascii", "replace").decode() for fit in fits]
        bars.set_yticks(np.arange(len(fits)), names, fontsize=7, parse_math=False)
        bars.set(xlabel="residual, px", ylim=(len(fits) - 0.5, -0.5))
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
