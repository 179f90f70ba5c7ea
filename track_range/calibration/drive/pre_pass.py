"""The pre-pass of recordings of one camera: all evidence of its focal length and distortion.

    recordings -> parts of them (drive_video) -> road users, horizon, motion (road_evidence)
               -> one source per kind of evidence -> CameraEstimate

`track-range calibrate` and every run of a recording without a calibration call it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from track_range.calibration.drive.drive_video import DriveVideo, Part
from track_range.calibration.drive.known_metres import Detect, KnownMeasurements, known_objects
from track_range.calibration.drive.road_evidence import LENS_SIGMA, RoadEvidence
from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import UsageError
from track_range.foundation.progress import StepProgress, no_progress
from track_range.ranging.cameras.camera_fit import CameraFit, fit_camera
from track_range.ranging.cameras.evidence import Evidence
from track_range.ranging.cameras.focal_evidence import VehicleShapes, vehicle_shapes
from track_range.ranging.cameras.measurements import CameraMeasurements, SceneBoxes
from track_range.ranging.cameras.posterior import posterior
from track_range.ranging.cameras.scale_evidence import height_by_speed
from track_range.ranging.cameras.unknowns import (
    FREE_SIGMA,
    OF_FOCAL,
    CameraPriors,
    Unknown,
    camera_priors,
)
from track_range.ranging.size_models.shared_sizes import CLASS_SIGMA
from track_range.ranging.size_models.size_model import SizeModel
from track_range.recording.cameras.camera_estimate import (
    N_GRID,
    CameraEstimate,
    FocalSource,
    SourceKind,
    source_of_curve,
    source_of_guess,
)
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.focal_curve import FocalCurve, log_focal_grid
from track_range.stereo.geometry.focal_guess import default_guess
from track_range.stereo.self_calibration.scene_motion import MotionEstimate

# smallest and largest height of a camera above the road that measurements may give, m
_CAMERA_HEIGHT_M = (0.3, 5.0)
# of a focal length from motion that says nothing: on a straight road focal length and depths are
# interchangeable. Up to it, the likelihood of the motion weighs itself.
_UNKNOWN_SIGMA = 0.4
_TURN_DEG = 5.0  # change of the heading that is called a turn
_MOST_VIEWS = 8  # of an object whose shape is evaluated


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveCamera:
    """A camera by all evidence of its recordings."""

    estimate: CameraEstimate
    shapes: VehicleShapes  # what the shapes of road users show, without any other source
    scene: SceneBoxes  # the road users, without the distortion
    n_frames: int  # number of frames that were read


@dataclass(frozen=True, slots=True, kw_only=True)
class MountedCamera(DriveCamera):
    """A camera with its height and pitch."""

    before: CameraEstimate  # the estimate without the measurements of the user
    fit: CameraFit

    @property
    def focal_sigma(self) -> float:
        """Relative standard deviation of the focal length; measurements that contradict each other
        widen it.
        """
        sigma = self.estimate.sigma
        return sigma if self.fit.contradiction == 1.0 else max(sigma, self.fit.focal_sigma)


@dataclass(frozen=True, slots=True, kw_only=True)
class PrePass:
    """How recordings of one camera are evaluated."""

    detect: Detect
    sizes: SizeModel
    prior: CameraEstimate | None = None  # by earlier recordings of the camera
    known: KnownMeasurements = field(default_factory=KnownMeasurements)
    progress: StepProgress = no_progress

    def camera_of(self, drives: Sequence[DriveVideo]) -> DriveCamera:
        """The camera of recordings, which have images of one size.

        Raises UsageError if a measurement is outside the image or the video, or none of an object,
        and VideoError if a video cannot be read.
        """
        if self.known.are_given:
            return self.mounted_camera_of(drives)
        if any(drive.speed is not None for drive in drives):
            return self._mounted(drives)
        return self._evaluated(drives[0], self._seen(drives, has_horizon=False))

    def mounted_camera_of(self, drives: Sequence[DriveVideo]) -> MountedCamera:
        """The camera with its height and pitch; the same errors, and UsageError if the height is
        impossible.
        """
        mounted = self._mounted(drives)
        low, high = _CAMERA_HEIGHT_M
        if not low <= mounted.fit.height_m <= high:
            raise UsageError(
                f"expected measurements that give a camera height of {low:g} to {high:g} m, found "
                f"{mounted.fit.height_m:.2f} m; check the boxes, the rows of lanes, and the "
                "distances in metres."
            )
        return mounted

    def _mounted(self, drives: Sequence[DriveVideo]) -> MountedCamera:
        first = drives[0]
        self.known.check(first)
        objects = known_objects(self.known.objects, first, self.detect)
        view = self._seen(drives, has_horizon=True)
        camera = self._evaluated(first, view)
        before = camera.estimate
        measured = CameraMeasurements(
            objects=objects,
            lanes=self.known.lanes,
            horizon=view.horizon(before.focal_px),
            scene=camera.scene,
            scene_noise=camera.shapes.relative_noise,
        )
        priors = drive_priors(before, self.known.camera_height_m)
        fit = fit_camera(before.size_px, priors, self.sizes, measured)
        return MountedCamera(
            estimate=self._with_evidence(before, priors, fit.evidence, view),
            shapes=camera.shapes,
            scene=camera.scene,
            n_frames=view.n_frames,
            before=before,
            fit=fit,
        )

    def _seen(self, drives: Sequence[DriveVideo], *, has_horizon: bool) -> RoadEvidence:
        """What the images of the drives show."""
        view = RoadEvidence(has_horizon=has_horizon)
        with self.progress("estimating the focal length") as advance:
            parts_s = [drive.parts_s() for drive in drives]
            self._read(view, drives, parts_s, advance)
            rest_s = [drive.rest_s(parts) for drive, parts in zip(drives, parts_s, strict=True)]
            # the sides of a road looked like a turn: road users of the rest say more
            if any(rest_s) and not view.shows_lens:
                self._read(view, drives, rest_s, advance)
        return view

    def _read(
        self,
        view: RoadEvidence,
        drives: Sequence[DriveVideo],
        parts_s: Sequence[Sequence[Part]],
        advance: Callable[[int, int | None], None],
    ) -> None:
        """Add the parts of each drive to `view`, and measure the lens."""
        names = _shown_names([str(drive.name) for drive in drives])
        for drive, name, parts in zip(drives, names, parts_s, strict=True):
            for start_s, duration_s in parts:
                with drive.opened(start_s, duration_s) as recording:
                    frames, camera = recording.frames, recording.camera
                    view.add(name, camera, frames, self.detect, advance, drive.speed)
        view.measure_lens()

    def _evaluated(self, drive: DriveVideo, view: RoadEvidence) -> DriveCamera:
        """The camera without the measurements of the user."""
        size_px, estimate = drive.size_px, self._without_images(drive)
        if view.lens is not None:
            estimate = with_motion(estimate, *view.lens)
        scene = undistorted(view.scene, estimate.camera)
        shapes = vehicle_shapes(thinned(scene), size_px, self.sizes)
        if shapes.n_tracks:
            by_shape = source_of_curve("shapes", shapes.name, shapes.curve, size_px)
            estimate = estimate.with_source(by_shape)
        return DriveCamera(estimate=estimate, shapes=shapes, scene=scene, n_frames=view.n_frames)

    def _without_images(self, drive: DriveVideo) -> CameraEstimate:
        """What is known of the camera without the images."""
        size_px, usual = drive.size_px, default_guess(drive.size_px)
        metadata = tuple(
            source_of_guess(guess, "metadata", size_px) for guess in drive.guesses if guess != usual
        )
        if self.prior is not None:
            return replace(self.prior, sources=(*self.prior.sources, *metadata))
        sources = metadata or (source_of_guess(usual, "usual", size_px),)
        return CameraEstimate(size_px=size_px, sources=sources)

    def _with_evidence(
        self,
        before: CameraEstimate,
        priors: CameraPriors,
        of_fit: Sequence[Evidence],
        view: RoadEvidence,
    ) -> CameraEstimate:
        """The estimate with the user's measurements and a given speed as a source."""
        evidence, names = [*of_fit], list[str]()
        kind: SourceKind = "known metres"
        if self.known.are_given:
            names.append("the known metres")
        if (height := view.heights.height_m) is not None:
            kind = "speed"
            names.append("the speed of the camera")
            height_m, sigma_m = height
            assumed = priors[Unknown.FOCAL].value * priors[Unknown.HEIGHT].value
            value = math.log(view.focal_px * height_m / assumed)
            evidence.append(height_by_speed(value, sigma_m / height_m))
        if not names:
            return before
        source = " and ".join(names)
        return before.with_source(
            source_of_evidence(kind, source, priors, evidence, before.size_px)
        )


def _shown_names(paths: Sequence[str]) -> list[str]:
    """Names of videos without their folders, unless two have the same one."""
    names = [Path(path).name for path in paths]
    return names if len(set(names)) == len(set(paths)) else [*paths]


def drive_priors(estimate: CameraEstimate, height_m: float | None) -> CameraPriors:
    """What is known of a camera beside its focal length, before its height was measured in drives;
    `height_m` is a given one. All road users have the sizes of one class.
    """
    priors = camera_priors(estimate.focal_px, focal_sigma=estimate.sigma, height_m=height_m)
    sigma = math.hypot(priors[Unknown.SIZES].sigma, CLASS_SIGMA)
    return {**priors, Unknown.SIZES: replace(priors[Unknown.SIZES], sigma=sigma)}


def source_of_evidence(
    kind: SourceKind,
    source: str,
    priors: CameraPriors,
    evidence: Sequence[Evidence],
    size_px: tuple[int, int],
) -> FocalSource:
    """The focal length by equations of all unknowns, as if it were not known before."""
    focal = replace(priors[Unknown.FOCAL], sigma=FREE_SIGMA, kind="unknown")
    cameras = posterior({**priors, Unknown.FOCAL: focal}, evidence)
    log_focal = log_focal_grid(size_px, N_GRID)
    log_p = cameras.log_density(OF_FOCAL, math.log(focal.value) - log_focal)
    return FocalSource(kind, source, FocalCurve(log_focal, log_p))


def with_motion(before: CameraEstimate, motion: MotionEstimate, video: str = "") -> CameraEstimate:
    """The estimate with the evidence of the motion of the static scene, where it shows any; the
    better known distortion of the two stays. `video` is the name of one of several.
    """
    minutes, seconds = divmod(round(motion.span_s[0]), 60)
    event = "turn" if motion.turn_deg >= _TURN_DEG else "motion of the static scene"
    source = f"the {event} at {minutes}:{seconds:02}" + (f" of {video}" if video else "")
    by_motion = source_of_curve("motion", source, motion.curve, before.size_px)
    sigma = by_motion.curve.estimate[1]
    if sigma > _UNKNOWN_SIGMA:
        return before
    estimate = before.with_source(by_motion)
    if sigma > LENS_SIGMA or before.k1_sigma <= motion.k1_sigma:  # False for NaN
        return estimate
    return replace(estimate, coefficients=motion.coefficients, k1_sigma=motion.k1_sigma)


def thinned(boxes: SceneBoxes) -> SceneBoxes:
    """Boxes with at most `_MOST_VIEWS` of each object, evenly spaced: further views add time, and
    hardly any information, since they share the size of the object.
    """
    order = np.argsort(boxes.track_id, kind="stable")
    _, first, count = np.unique(boxes.track_id[order], return_index=True, return_counts=True)
    views = [
        start + np.unique(np.linspace(0, n - 1, min(n, _MOST_VIEWS)).round().astype(np.int64))
        for start, n in zip(first, count, strict=True)
    ]
    return boxes.select(np.sort(order[np.concatenate([np.zeros(0, np.int64), *views])]))


def undistorted(boxes: SceneBoxes, camera: PinholeCamera) -> SceneBoxes:
    """Boxes of recorded images in the images without distortion: by the middles of their edges."""
    if not camera.is_distorted or not len(boxes):
        return boxes
    x1, y1, x2, y2 = boxes.xyxy_px.T
    x, y = (x1 + x2) / 2, (y1 + y2) / 2

    def moved(x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        rays = camera.recorded_rays(np.stack([x_px, y_px], axis=1))
        return camera.without_distortion().project(rays)

    sides = [moved(x1, y)[:, 0], moved(x, y1)[:, 1], moved(x2, y)[:, 0], moved(x, y2)[:, 1]]
    return replace(boxes, xyxy_px=np.stack(sides, axis=1))
