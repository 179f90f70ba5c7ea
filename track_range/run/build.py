"""Opens the recording of a run and builds its pipeline from the settings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.lanes.nets import open_lane_finder
from track_range.detection.models.onnx_session import Runtime
from track_range.foundation.arrays import Image
from track_range.foundation.background import Background, InThreads
from track_range.foundation.errors import Note
from track_range.foundation.progress import StepProgress, no_progress
from track_range.foundation.sparse_flow import BackgroundFlow
from track_range.pipeline.alarming import AlarmStage
from track_range.pipeline.clock import StageClock
from track_range.pipeline.detecting import DetectionStage
from track_range.pipeline.doubting import DoubtStage
from track_range.pipeline.ego import EgoStage, StandingCamera
from track_range.pipeline.filtering import FilterStage
from track_range.pipeline.frame_pipeline import FramePipeline
from track_range.pipeline.world import WorldStage
from track_range.ranging.cameras.learnt_focal import FocalEstimate
from track_range.ranging.cameras.scale_check import ScaleCheck
from track_range.ranging.cameras.scale_evidence import speed_ratio_sigma
from track_range.ranging.cameras.unknowns import CameraPriors, Unknown, camera_priors
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.methods.ground_plane import GroundSettings
from track_range.ranging.methods.lane_width import usual_width
from track_range.ranging.methods.method import MethodContext
from track_range.ranging.registry import methods
from track_range.ranging.size_models.class_sizes import ClassSizes
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.region import Region
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.ranging.warning.settings import WarningSettings
from track_range.ranging.world.ground_file import checked_plane, read_ground
from track_range.ranging.world.road_motion import RoadMotions
from track_range.ranging.world.road_plane import RoadPlane
from track_range.recording.cameras.calibration import LensView, RecordingCalibration, calibration_of
from track_range.recording.recording import Recording, open_recording
from track_range.run.box_source import BoxSource, boxes_of
from track_range.run.options.opened import open_tracker_options
from track_range.run.options.opened_methods import fused_methods, left_out, open_methods
from track_range.run.options.settings import PipelineOptions, RunSettings
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.mounting import Mounting, looks_ahead
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.odometry.ground_odometry import GroundOdometry
from track_range.stereo.odometry.stereo_odometry import StereoOdometry
from track_range.stereo.speed.ego_speed import EgoSpeed
from track_range.tracking.registry import ObjectTracker, TrackerOptions, create_tracker

_NOT_AHEAD = Note(
    "The view does not look along the drive (--mount, --yaw-deg): it has no lane lines, no times to "
    "collision and no collision warnings; distances are along its axis.",
    "view-not-ahead",
    "warning",
    "left",
)
_OTHER_HEIGHT = Note(
    "The camera height is as given, and not the {:g} m of the calibration or mounting.",
    "height-given",
    "ok",
    "calibration",
)
_BY_SIZES = Note(
    "The speeds of this fixed camera rest on usual sizes of road users; give --ground, or the height "
    "and pitch of the camera by --mount, for speeds by the plane of the road.",
    "fixed-camera-without-ground",
    "warning",
    "calibration",
)

# images of the warm-up, and what moves in them
_FOCAL_SIGMA = 0.005  # of a calibrated focal length, at least
_WARM_UP_PX, _FOCAL_PX, _BASELINE_M = (640, 360), 500.0, 0.3
_STEP_S, _N_STEPS = 0.1, 6  # a track is ranged from its third frame on
_MOTION_PX, _DISPARITY_PX = 4, 10
_CAR_PX = (280.0, 170.0, 360.0, 230.0)


@dataclass(frozen=True, slots=True)
class SpeedInput:
    """The speed of the camera, as a run gets it."""

    given: EgoSpeed | None = None  # from telemetry or a setting
    # whether it is measured from the images, if none is given and a scale is known
    is_measured: bool = True


def open_input(
    settings: RunSettings, progress: StepProgress = no_progress, rig: StereoRig | None = None
) -> Recording:
    """The recording of the settings, with `rig` instead of their calibration. Raises the errors of
    `open_recording`.
    """
    left, right = settings.stereo or (settings.left, None)
    options = settings.recording
    if rig is not None:
        options = replace(options, rig=rig)
    elif settings.ground is not None and options.rig is None and options.focal_px is None:
        focal_px = read_ground(settings.ground).plain_focal_px
        options = replace(options, focal_px=focal_px)
    return open_recording(left, right, options, progress=progress)


def open_pipeline(
    settings: PipelineOptions,
    calibration: RecordingCalibration,
    boxes: BoxSource,
    *,
    region: Region = "unknown",
    tracker: ObjectTracker | None = None,
    speed: SpeedInput | None = None,
    needs_candidates: bool = False,
    background: Background | None = None,
) -> FramePipeline:
    """The pipeline of the settings, with the methods that the calibration allows.

    `tracker` replaces the tracker of the settings; `speed` None = it is measured from the images.
    With `needs_candidates`, results have all boxes, for anonymization. Long estimates are made in
    the `background`; None = in threads, with waiting.

    CurveError: the size curves cannot be read; ModelError: the re-identification or lane network
    cannot be used; TrackerError: the tracker cannot be created; MethodError: ranging methods of
    other packages depend on each other in a cycle, or a method that the settings ask for cannot
    measure; the errors of opening networks.
    """
    mounting = calibration.view_mounting(settings.mounting)
    context = _method_context(settings, calibration, boxes, region, mounting)
    priors = _camera_priors(context, calibration)
    check = _scale_check(context, priors, calibration, settings.lane_width_m, background)
    runtime = context.runtime or Runtime()
    tracker_options = open_tracker_options(settings.reid, runtime, settings.tracker_min_score)
    appearance_notes = () if tracker_options.reid is None else tracker_options.reid.notes
    lane_finder = open_lane_finder(settings.lanes, runtime) if context.has_lane_lines else None
    camera = calibration.camera
    ego_of = partial(
        _ego_stage,
        context,
        speed or SpeedInput(),
        priors,
        mounting=mounting,
        background=background,
        is_static=settings.static_camera,
    )
    of_scene = partial(
        _stages_of_scene, settings, camera, tracker or tracker_options, ego_of, mounting=mounting
    )
    first_tracker, ego, alarming = of_scene()
    ranging = open_methods(settings, context)
    return FramePipeline(
        detection=DetectionStage(
            detect=boxes.detect,
            prepare=boxes.prepare,
            candidates=boxes.candidates if needs_candidates else None,
            lane_finder=lane_finder,
            fixed_parts=boxes.fixed_parts,
        ),
        tracker=first_tracker,
        ego=ego,
        restarted=of_scene,
        ranging=ranging,
        fusion=Fusion(fused_methods(ranging)),
        doubting=DoubtStage(priors, check, _focal_before(calibration)),
        filtering=FilterStage(
            camera,
            methods_of_run=ranging.rangers,
            has_visible_boxes=context.has_visible_boxes,
            mounting=mounting,
        ),
        world=_world_stage(context, calibration, mounting),
        alarming=alarming,
        setup_notes=(
            *appearance_notes,
            *_setup_notes(settings, context, calibration, mounting),
            *left_out(settings, ranging),
        ),
        background=background or InThreads(),
        clock=StageClock(ranging.rangers),
    )


def _world_stage(
    context: MethodContext, calibration: RecordingCalibration, mounting: Mounting | None
) -> WorldStage:
    """Places the tracks before the camera, whose view has a `mounting`."""
    return WorldStage(
        calibration.camera,
        centre_sigma_px=calibration.centre_sigma_px,
        mounting=_at_height(mounting, context.camera_height_m),
        sizes=ClassSizes.of(context.size_model),
        traits=context.traits,
        road=None if context.road_plane is None else RoadMotions(context.road_plane),
    )


def _setup_notes(
    settings: PipelineOptions,
    context: MethodContext,
    calibration: RecordingCalibration,
    mounting: Mounting | None,
) -> Iterator[str]:
    """Notes on the mounting and on what a camera that stands still lacks."""
    mounted_m = _mounted_m(mounting, calibration)
    if mounted_m not in (None, context.camera_height_m):
        yield _OTHER_HEIGHT.format(mounted_m)
    if settings.static_camera and context.road_plane is None:
        yield _BY_SIZES
    if not looks_ahead(mounting) and not settings.static_camera:
        yield _NOT_AHEAD


def _stages_of_scene(
    settings: PipelineOptions,
    camera: PinholeCamera,
    tracker: ObjectTracker | TrackerOptions,
    ego_of: Callable[[BackgroundFlow], EgoStage],
    *,
    mounting: Mounting | None,
) -> tuple[ObjectTracker, EgoStage, AlarmStage]:
    """The stages that start again with another scene; a `tracker` that is given goes on."""
    flow = BackgroundFlow()
    if isinstance(tracker, TrackerOptions):
        tracker = create_tracker(settings.tracker, replace(tracker, flow=flow))
    warning = None
    if looks_ahead(mounting):
        warning = CollisionWarning(_from_bumper(settings, mounting))
    return tracker, ego_of(flow), AlarmStage(camera, warning)


def _from_bumper(settings: PipelineOptions, mounting: Mounting | None) -> WarningSettings:
    """The settings of the warning, with the front of the vehicle as the mounting has it; a
    `front_m` that is given is that of the user.
    """
    chosen = settings.warning_settings
    bumper_m = None if mounting is None else mounting.bumper_m
    if bumper_m is None or "front_m" in settings.warning_options:
        return chosen
    return replace(chosen, front_m=bumper_m)


def _at_height(mounting: Mounting | None, height_m: float | None) -> Mounting | None:
    """The mounting at the height of the camera above the road that is in use."""
    return None if mounting is None else replace(mounting, z_m=height_m)


def _method_context(
    settings: PipelineOptions,
    calibration: RecordingCalibration,
    boxes: BoxSource,
    region: Region,
    mounting: Mounting | None,
) -> MethodContext:
    return MethodContext(
        camera=calibration.camera,
        rig=calibration.rig,
        focal_sigma=calibration.focal_sigma,
        size_model=load_curves(settings.curves, region),
        box_errors=boxes.box_errors,
        camera_height_m=settings.camera_height_m or _mounted_m(mounting, calibration),
        region=region,
        lane_width_m=settings.lane_width_m,
        has_visible_boxes=settings.detections is None,
        has_lane_lines=settings.lanes != "off"
        and looks_ahead(mounting)
        and not settings.static_camera,
        road_plane=road_plane_of(settings, calibration),
        has_dense_disparity=settings.sgbm,
        has_recorded_depth=calibration.has_depth,
        sgbm_options=settings.sgbm_options,
        runtime=Runtime(n_threads=settings.threads, device=settings.device),
        depth_models=settings.networks["depth"],
        stereo_models=settings.networks["disparity"],
    )


def road_plane_of(settings: PipelineOptions, calibration: RecordingCalibration) -> RoadPlane | None:
    """The plane of the road of a camera that stands still: of its file, else by the height and the
    pitch of its mounting; None = unknown. GroundError: the file cannot be used.
    """
    mounting, camera = settings.mounting, calibration.camera
    if not settings.static_camera:
        return None
    if settings.ground is not None:
        return checked_plane(settings.ground, camera)
    if mounting is None or mounting.z_m is None or mounting.pitch_deg <= 0:
        return None
    return RoadPlane.of_mounting(camera, mounting, max(calibration.focal_sigma, _FOCAL_SIGMA))


def _mounted_m(mounting: Mounting | None, calibration: RecordingCalibration) -> float | None:
    """Height of the camera in its mounting, else in its calibration; None = unknown."""
    return (None if mounting is None else mounting.z_m) or calibration.camera_height_m


def _road_height_m(context: MethodContext) -> float:
    """Height with which the motion of the road is measured: as given, or a usual one."""
    return context.camera_height_m or GroundSettings().height_m


def _ego_stage(
    context: MethodContext,
    speed: SpeedInput,
    priors: CameraPriors,
    flow: BackgroundFlow,
    *,
    mounting: Mounting | None,
    background: Background | None,
    is_static: bool,
) -> EgoStage:
    """The sources of the ego motion: a scale has a pair, or a camera by its height above the road,
    which is given, or usual until the drive shows it.
    """
    if is_static:
        return StandingCamera()
    # also follows the right camera, and checks a given speed
    pair_odometry = (
        None
        if context.rig is None
        else StereoOdometry(context.rig, flow=flow, background=background)
    )
    axes = None if mounting is None else mounting.travel_from_camera
    uses_pair_speed = speed.is_measured or speed.given is not None
    road_height_m = _road_height_m(context)
    return EgoStage(
        speed=speed.given,
        pair_odometry=pair_odometry,
        uses_pair_speed=looks_ahead(mounting) and uses_pair_speed,
        road_motion=GroundOdometry(
            context.camera, road_height_m, flow=flow, travel_from_camera=axes
        ),
        uses_road_speed=speed.is_measured and speed.given is None,
        has_given_height=context.camera_height_m is not None,
        speed_ratio_sigma=speed_ratio_sigma(priors),
        mounting=mounting,
    )


def _camera_priors(context: MethodContext, calibration: RecordingCalibration) -> CameraPriors:
    """What is known of the cameras before the drive."""
    rig = context.rig
    priors = camera_priors(
        context.camera.fx_px,
        focal_sigma=calibration.scale_sigma if rig is None else context.focal_sigma,
        baseline_m=None if rig is None else rig.baseline_m,
        baseline_sigma=0.0 if rig is None else rig.baseline_sigma,
        scale_sigma=calibration.scale_sigma,
        height_m=context.camera_height_m,
        region=context.region,
    )
    if calibration.estimate is None:
        return priors
    # its evidence is from this drive, and counts once
    shown = replace(priors[Unknown.FOCAL], kind="unknown", curve=calibration.estimate.curve)
    return {**priors, Unknown.FOCAL: shown}


def _focal_before(calibration: RecordingCalibration) -> FocalEstimate | None:
    """A focal length that was not given, as it is known before the drive."""
    focal = calibration.focal
    return None if focal is None else FocalEstimate(focal.focal_px, focal.sigma, focal.source)


def _scale_check(
    context: MethodContext,
    priors: CameraPriors,
    calibration: RecordingCalibration,
    lane_width_m: float | None,
    background: Background | None,
) -> ScaleCheck:
    # disparities of a calibrated pair that the user wants as they are
    alignment = calibration.alignment
    is_off = alignment is not None and alignment.is_off and calibration.kind == "rig"
    return ScaleCheck(
        context.camera,
        priors,
        rig=None if is_off else context.rig,
        lane=usual_width(context.region, lane_width_m),
        sizes=context.size_model,
        road_height_m=_road_height_m(context),
        # that of a recording was estimated from all of it
        learns_focal=calibration.focal is not None and calibration.estimate is None,
        background=background,
    )


class _OneCar:
    """A detector that sees a car at the same place in every image."""

    def detect(self, image: Image) -> Detections:
        del image
        return Detections.of([_CAR_PX], [0.9], [ROAD_CLASSES.index("car")])


def warm_up(options: PipelineOptions, *, is_pair: bool) -> None:
    """Use the parts of a pipeline but its networks on images of noise.

    Modules are then imported, and tables computed: of the sizes of road users, 0.2 s, and of
    OpenCV's colours, 0.07 s. Ranging methods of other packages are not used for this.
    """
    if any(not method.create.__module__.startswith("track_range.") for method in methods(())):
        return
    camera = PinholeCamera.of_focal_length(_FOCAL_PX, _WARM_UP_PX)
    cameras = StereoRig.rectified(camera, baseline_m=_BASELINE_M) if is_pair else camera
    calibration = calibration_of(cameras, (_WARM_UP_PX,) * (1 + is_pair), LensView())
    # networks of appearance and lanes are not opened twice
    usual = options.model_copy(
        update={
            "sgbm": False,
            "reid": None,
            "lanes": "classical",
            "tracker": "road",
            "ground": None,
            "methods": (),
            "show_only": (),
            "depth_model": (),
            "stereo_model": (),
        }
    )
    stages = open_pipeline(usual, calibration, boxes_of(_OneCar()))
    noise = np.random.default_rng(0).integers(0, 256, (*_WARM_UP_PX[::-1], 3), np.uint8)
    for index in range(_N_STEPS):
        left = np.roll(noise, _MOTION_PX * index, axis=1)
        right = np.roll(left, -_DISPARITY_PX, axis=1) if is_pair else None
        frame = Frame(index, index * _STEP_S, left, right)
        stages.step(stages.detected(frame))
    stages.close()
