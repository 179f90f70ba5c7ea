"""Frame results and pipelines for tests, from few values."""

from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from track_range.pipeline.alarming import Alarms, AlarmStage
from track_range.pipeline.doubting import DoubtStage
from track_range.pipeline.ego import EgoStage
from track_range.pipeline.filtering import Approach, FilterStage
from track_range.pipeline.frame_pipeline import FramePipeline
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.world import World, WorldStage
from track_range.ranging.cameras.doubt import Doubt
from track_range.ranging.cameras.unknowns import CameraPriors
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.ranging.world.cuboids import Cuboids
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import ObjectMotion
from track_range.results.writers import (
    OpenWriters,
    RunInfo,
)
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

INFO = RunInfo(
    camera=PinholeCamera(700.0, 700.0, 320.0, 240.0, 640, 480), rig=None, fps=10.0, settings={}
)


def frame_result(
    frame: Frame, tracks: Tracks, ranges: dict[str, Ranges], **values: Any
) -> FrameResult:
    """A result with the given values, such as `closing_mps`; all others are unknown."""
    n = len(tracks)
    result = FrameResult(
        frame, tracks, ranges, Approach.unknown(n), World.unknown(n), Alarms.none(n)
    )
    return changed(result, **values)


def changed(result: FrameResult, **values: Any) -> FrameResult:
    """The result with other values of its fields, or of the parts of its fields."""
    parts: dict[str, Any] = {}
    for name, value in values.items():
        if name in ("closing_mps", "closing_sigma_mps", "ttc_s", "ttc_sigma_s"):
            parts["approach"] = replace(parts.get("approach", result.approach), **{name: value})
        elif name in ("xyz_m", "xy_sigma_m", "motion", "ego_pose", "cuboids"):
            parts["world"] = replace(parts.get("world", result.world), **{name: value})
        elif name in ("warnings", "safety"):
            alarms = parts.get("alarms", result.alarms)
            parts["alarms"] = replace(alarms, **{name: value, f"has_{name}": True})
        elif name in ("ego_mps", "ego_sigma_mps"):
            speed = {name.replace("ego", "speed"): value}
            parts["ego"] = replace(parts.get("ego", result.ego), **speed)
        elif name == "scale_doubt":
            parts["doubt"] = Doubt(value)
        else:
            parts[name] = value
    return replace(result, **parts)


def frame_pipeline(
    camera: PinholeCamera, *, priors: CameraPriors | None = None, **stages: Any
) -> FramePipeline:
    """A pipeline without ego motion and doubt, but with warnings."""
    return FramePipeline(
        ego=EgoStage(),
        doubting=DoubtStage(priors or {}),
        filtering=FilterStage(camera),
        world=WorldStage(camera),
        alarming=AlarmStage(camera, CollisionWarning()),
        **stages,
    )


def result(frame=4):
    """Tracks 3, a car that is measured, and 7, a predicted train that is not."""
    tracks = Tracks(
        np.array([3, 7]),
        np.array([[1.0, 2.0, 3.0, 4.5], [10.0, 20.0, 30.0, 40.0]]),
        np.array([2, 6]),
        np.array([0.5, 0.25]),
        np.array([True, False]),
    )
    nan = np.nan
    ranges = {
        "mono": Ranges(tracks.track_id, np.array([12.3456, nan]), np.array([1.0, nan])),
        "fused": Ranges(tracks.track_id, np.array([12.0, nan]), np.array([0.5, nan])),
        "fused_kf": Ranges(tracks.track_id, np.array([12.5, 8.0]), np.array([0.4, 0.3])),
    }
    image = np.zeros((50, 50, 3), np.uint8)
    xyz_m = np.array([[1.0, 2.0, 12.0], [nan, nan, nan]])
    return frame_result(
        frame=Frame(frame, 0.4, image, None),
        tracks=tracks,
        ranges=ranges,
        closing_mps=np.array([2.0, nan]),
        closing_sigma_mps=np.array([0.5, nan]),
        ttc_s=np.array([6.0, nan]),
        ttc_sigma_s=np.array([1.5, nan]),
        xyz_m=xyz_m,
        xy_sigma_m=np.array([[0.25, 0.125], [nan, nan]]),
        motion=ObjectMotion(
            *(
                np.array(pair)
                for pair in (
                    (8.5, nan),
                    (0.4, nan),
                    (-12.5, nan),
                    (20.25, nan),
                    (-3.5, nan),
                    (nan, 0.0),
                    (nan, 0.96),
                )
            )
        ),
        ego_pose=EgoPose(8.0, -1.0, -0.5, np.diag([0.04, 0.01, 0.0001])),
        cuboids=with_unknown(cuboids()),
        ego_mps=10.0,
    )


def cuboids(n=1, **values):
    """Cuboids of n cars 12 m ahead that drive as the camera looks, or with other values."""
    arrays = {
        "lwh_m": [4.0, 1.8, 1.5],
        "lwh_sigma_m": [0.3, 0.1, 0.1],
        "yaw_deg": 0.0,
        "yaw_sigma_deg": 5.0,
        "front_known": True,
        "centre_m": [1.0, 0.8, 14.0],
        "centre_sigma_m": [0.2, 0.1, 0.5],
        "centre_correlation": [0.0, 0.0, 0.0],
        "vehicle_m": [np.nan] * 3,
        "world_m": [20.25, -3.5, np.nan],
        **values,
    }
    return Cuboids(**{name: np.array([given] * n) for name, given in arrays.items()})


def with_unknown(known):
    """Cuboids followed by one that is not known."""
    unknown = Cuboids.unknown(1)
    pairs = {name: (getattr(known, name), getattr(unknown, name)) for name in Cuboids.__slots__}
    return Cuboids(**{name: np.concatenate(pair) for name, pair in pairs.items()})


@contextmanager
def writing(folder, names=("csv", "mot"), info=INFO):
    """Context with the open writers of these names."""
    with OpenWriters(names, info, folder) as opened:
        yield opened
