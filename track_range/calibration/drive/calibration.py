"""Calibration of one camera from its drives: `track-range calibrate --mono` and `calibrate drive`.

recordings -> pre-pass (pre_pass) -> focal length, distortion, height and pitch -> rig.yaml
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from track_range.calibration.drive.drive_video import DriveVideo
from track_range.calibration.drive.known_metres import (
    Detect,
    KnownMeasurements,
    known_lanes,
    known_metres,
)
from track_range.calibration.drive.pre_pass import (
    MountedCamera,
    PrePass,
)
from track_range.calibration.drive.separability import separability
from track_range.calibration.settings import DriveSettings
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import counted
from track_range.foundation.files.output_files import check_outputs, write_json
from track_range.foundation.progress import StepProgress, no_progress
from track_range.ranging.cameras.camera_fit import CameraFit
from track_range.ranging.cameras.unknowns import GIVEN_SIGMA
from track_range.ranging.size_models.curve import load_curves
from track_range.recording.cameras.camera_estimate import CameraEstimate, source_of_guess
from track_range.recording.cameras.known_lenses import GivenLens
from track_range.recording.sources.names import source_of, video_name
from track_range.recording.speed_source import AUTO, OFF
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.focal_guess import FocalGuess
from track_range.stereo.geometry.rig import RoadCalibration
from track_range.stereo.rig_formats.reading import load_camera, read_calibration
from track_range.stereo.rig_formats.rig_yaml import save_camera

_ROUNDING_M = 0.001  # of the heights in files
_UNSTATED_SIGMA = 0.02  # of a focal length whose file has no standard deviation; assumed


@dataclass(frozen=True, slots=True)
class DriveCalibration:
    """A camera calibrated from its drives."""

    source: str  # the videos
    mounted: MountedCamera
    guesses: tuple[FocalGuess, ...]  # guesses of the focal length from outside the images
    sentences: tuple[str, ...]  # what the measurements determine, in words

    @property
    def fit(self) -> CameraFit:
        """The fit of all measurements."""
        return self.mounted.fit

    @property
    def camera(self) -> PinholeCamera:
        """The camera, whose distortion is empty unless the motion shows one."""
        return self.mounted.estimate.camera

    @property
    def road(self) -> RoadCalibration:
        """Height and pitch of the camera, and the uncertainty of its focal length."""
        fit, estimate = self.fit, self.mounted.estimate
        return RoadCalibration(
            focal_sigma=round(self.mounted.focal_sigma, 4),
            camera_height_m=round(fit.height_m, 3),
            camera_height_sigma_m=round(fit.height_sigma_m, 3),
            pitch_deg=round(float(np.degrees(fit.pitch_rad(estimate.camera))), 3),
            pitch_sigma_deg=round(float(np.degrees(fit.pitch_sigma_rad)), 3),
            k1_sigma=round(estimate.k1_sigma, 5) if estimate.distortion else None,
        )

    def save(self, settings: DriveSettings) -> list[Path]:
        """Write the camera and the results, where files are given, and return their paths;
        OutputError or RigError.
        """
        if settings.out is not None:
            known = len({residual.name for residual in self.fit.residuals})
            drives = counted(len(settings.recordings), "recording")
            comments = [f"track-range calibrate: from {drives} of drives, {known} measurements"]
            save_camera(self.camera, settings.out, comments=comments, road=self.road)
        if settings.json_file is not None:
            write_json(settings.json_file, self.figures)
        return [file for file in (settings.out, settings.json_file) if file is not None]

    @property
    def figures(self) -> dict[str, Any]:
        """All values, as plain values for JSON."""
        fit, mounted = self.fit, self.mounted
        shapes = mounted.shapes
        by_shapes: tuple[float | None, ...] = (None, None)
        if shapes.n_tracks:
            by_shapes = shapes.curve.estimate
        return {
            "source": self.source,
            "frames": mounted.n_frames,
            "focal_px": mounted.estimate.focal_px,
            **asdict(self.road),
            "roll_deg": float(np.degrees(fit.roll_rad)),
            "focal_height_sigma": fit.product_sigma,
            "guesses": [asdict(guess) for guess in self.guesses],
            "by_shape": {
                "focal_px": by_shapes[0],
                "sigma": by_shapes[1],
                "tracks": shapes.n_tracks,
                "box_noise": shapes.relative_noise,
            },
            "camera_estimate": mounted.estimate.summary(),
            "residuals": [asdict(residual) for residual in fit.residuals],
            "determined": list(self.sentences),
        }


def calibrate_from_drives(
    settings: DriveSettings,
    open_detect: Callable[[], Detect],
    progress: StepProgress = no_progress,
) -> DriveCalibration:
    """Calibrate the camera of the recordings of the settings; nothing is written before
    `DriveCalibration.save`.

    `open_detect` opens the detector. Raises UsageError if a measurement is invalid, or outside the
    image or the video, or the recordings are of different sizes, and VideoError if a video cannot
    be read.
    """
    if not settings.recordings:
        raise UsageError(
            "expected --mono VIDEO; without --board, one camera is calibrated from a drive."
        )
    objects = known_metres(settings.known_distance, settings.known_height, settings.known_width)
    known = KnownMeasurements(
        objects=objects,
        lanes=known_lanes(settings.known_lane_width),
        camera_height_m=settings.camera_height_m,
    )
    names = [video_name(name) for name in settings.recordings]
    _check_once([str(name) for name in names])
    lens = GivenLens(settings.camera_model, settings.lens_fov_deg)
    drives = [DriveVideo.of(name, lens) for name in names]
    first = drives[0]
    for drive in drives[1:]:
        if drive.size_px != first.size_px:
            (w, h), (fw, fh) = drive.size_px, first.size_px
            raise UsageError(
                f"{drive.name}: expected images of {fw}x{fh} px as in {first.name}, found "
                f"{w}x{h} px; recordings of one camera have one size, so calibrate each apart."
            )
    outputs = [file for file in (settings.out, settings.json_file) if file is not None]
    check_outputs(outputs, [file for name in names for file in source_of(name).files])
    if settings.ego_speed not in (AUTO, OFF) and len(drives) > 1:
        raise UsageError(
            f"--ego-speed {settings.ego_speed}: expected auto or off for several recordings, whose "
            "speeds are beside them; calibrate one recording, and continue from it with --rig."
        )
    drives = [drive.with_speed(settings.ego_speed) for drive in drives]
    prior, height_m = (None, None) if settings.rig is None else _prior(settings.rig, first)
    if known.camera_height_m is None:
        known = replace(known, camera_height_m=height_m)
    pre_pass = PrePass(
        detect=open_detect(),
        sizes=load_curves(settings.curves, "europe"),
        prior=prior,
        known=known,
        progress=progress,
    )
    mounted = pre_pass.mounted_camera_of(drives)
    has_height = known.camera_height_m is not None
    sentences = separability(mounted, has_height=has_height)
    source = " ".join(str(name) for name in names)
    return DriveCalibration(source, mounted, first.guesses, sentences)


def _check_once(names: Sequence[str]) -> None:
    """Raise UsageError for a recording that is given twice: its evidence counts once."""
    repeated = [name for name, n in Counter(names).items() if n > 1]
    if repeated:
        raise UsageError(
            f"{repeated[0]}: expected every recording once, found it "
            f"{names.count(repeated[0])} times; its evidence would count twice."
        )


def _prior(path: Path, drive: DriveVideo) -> tuple[CameraEstimate, float | None]:
    """What a calibration file says of the camera, and its height above the road if it was measured:
    one by the sizes of road users has errors that other drives share. RigError if it cannot be
    used.
    """
    camera, _ = load_camera(path, size_px=drive.size_px)
    if camera.is_wide:
        raise UsageError(
            f"{path}: expected a pinhole camera, found a wide lens, which drives do not calibrate."
        )
    content = read_calibration(path, is_grey=False, is_pair=False, size_px=drive.size_px)
    road, stated = content.road, content.road or content.accuracy
    sigma = _UNSTATED_SIGMA if stated is None else stated.focal_sigma
    focal = FocalGuess(camera.fx_px, max(sigma, 1e-3), str(path.name))
    given = source_of_guess(focal, "given", drive.size_px)
    estimate = CameraEstimate(
        size_px=drive.size_px, sources=(given,), principal_px=(camera.cx_px, camera.cy_px)
    )
    if camera.distortion:
        k1_sigma = 0.0 if road is None else road.k1_sigma or 0.0
        estimate = replace(estimate, coefficients=camera.distortion, k1_sigma=k1_sigma)
    if road is None:
        return estimate, None
    if road.camera_height_sigma_m > GIVEN_SIGMA * road.camera_height_m + _ROUNDING_M:
        return estimate, None
    return estimate, road.camera_height_m
