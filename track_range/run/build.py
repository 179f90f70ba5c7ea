"""Where the pipeline of a run is put together: which methods measure, with which settings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.detection.lanes.lookup import open_lane_finder
from track_range.detection.models.onnx_session import Runtime
from track_range.ranging.ego_speed import open_ego_speed
from track_range.ranging.methods.dense_stereo import DenseRanger
from track_range.ranging.methods.ground_plane import GroundPlaneRanger, GroundSettings
from track_range.ranging.methods.lane_width import LaneWidthRanger
from track_range.ranging.methods.patch_stereo import PatchRanger
from track_range.ranging.methods.size_regression import SizeRegressionRanger
from track_range.ranging.methods.size_scaled_stereo import SizeScaledRanger
from track_range.ranging.ranger import OncePerFrame, Ranger
from track_range.ranging.size_models.size_model import SizeModel
from track_range.run.box_source import BoxSource
from track_range.run.pipeline import Pipeline
from track_range.run.settings import RunSettings
from track_range.run.tracker_options import open_tracker_options
from track_range.stereo.alignment.model import Alignment
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patch_matcher import PatchMatcher, PatchMatcherSettings
from track_range.stereo.matching.sgbm import SgbmSettings
from track_range.tracking.registry import create_tracker
from track_range.video.source import Source
from track_range.video.uncalibrated import ASSUMED_BASELINE_M, UncalibratedPair


def open_pipeline(settings: RunSettings, source: Source, boxes: BoxSource, curves: SizeModel) -> Pipeline:
    """The pipeline that the settings ask for and the source allows.

    Raises:
        ModelError: the network for looks or for lanes cannot be used.
        TrackerError: the tracker cannot be made.
        EgoSpeedError: the ego speed cannot be used.
    """
    by_size = OncePerFrame(SizeRegressionRanger(source.camera, curves))  # ground and scale ask it too
    ground = _ground(settings, source, by_size)
    rangers: dict[str, Ranger] = {"mono": by_size, "ground": ground}
    dense, taken = None, source.uncalibrated
    if source.rig is not None:
        alignment = source.alignment.applied if source.alignment else Alignment()
        rangers["stereo"] = PatchRanger(source.rig, _patch_matcher(source.rig), alignment=alignment)
        if settings.sgbm:
            dense_settings = SgbmSettings.for_rig(source.rig, chosen=settings.sgbm_options)
            dense = DenseRanger(source.rig, dense_settings, alignment=alignment)
    elif taken is not None and taken.has_equal_rows:
        guessed = StereoRig.rectified(taken.camera, ASSUMED_BASELINE_M)
        rangers["stereo"] = SizeScaledRanger(_patch_matcher(guessed), by_size)
    runtime = Runtime(n_threads=settings.threads, device=settings.device)
    tracker_options = open_tracker_options(settings.reid, runtime)
    return Pipeline(
        camera=source.camera,
        detect=boxes.detect,
        tracker=create_tracker(settings.tracker, tracker_options),
        rangers=rangers,
        lane_finder=None if settings.lanes == "off" else open_lane_finder(settings.lanes, runtime),
        ground=ground.plane,
        lane=LaneWidthRanger(source.camera, width_m=settings.lane_width_m),
        dense=dense,
        ego_speed=None if settings.ego_speed is None else open_ego_speed(settings.ego_speed),
        shared_sigma=taken.focal_sigma if taken is not None else 0.0,
        is_live=source.live is not None,
        notes=() if tracker_options.reid is None else tracker_options.reid.notes,
    )


def _ground(settings: RunSettings, source: Source, by_size: Ranger) -> GroundPlaneRanger:
    height_m = settings.camera_height_m
    known = None if height_m is None else GroundSettings.of_known_height(height_m)
    return GroundPlaneRanger(source.camera, by_size, known)


def _patch_matcher(rig: StereoRig) -> PatchMatcher:
    return PatchMatcher(PatchMatcherSettings.for_rig(rig))


@dataclass(frozen=True, slots=True, kw_only=True)
class LearntScale:
    """What a run without a rig has learnt of its pair by now."""

    focal_px: float
    baseline_m: float
    relative_sigma: float
    n_tracks: int


def learnt_scale(pipeline: Pipeline, taken: UncalibratedPair | None) -> LearntScale | None:
    """None with a rig, with one camera, and as long as no track has told anything."""
    ranger = pipeline.rangers.get("stereo")
    if taken is None or not isinstance(ranger, SizeScaledRanger) or not ranger.scale.n_tracks:
        return None
    focal_baseline, sigma = ranger.scale.estimate()
    return LearntScale(
        focal_px=taken.camera.fx_px,
        baseline_m=focal_baseline / taken.camera.fx_px,
        relative_sigma=float(np.hypot(sigma, taken.focal_sigma)),
        n_tracks=ranger.scale.n_tracks,
    )
