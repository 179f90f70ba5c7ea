"""Frame results and pipelines for tests, from few values."""

from dataclasses import replace
from typing import Any

from track_range.pipeline.alarming import Alarms, AlarmStage
from track_range.pipeline.doubting import DoubtStage
from track_range.pipeline.ego import EgoStage
from track_range.pipeline.filtering import Approach, FilterStage
from track_range.pipeline.frame_pipeline import FramePipeline
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.world import World, WorldStage
from track_range.ranging.doubt.doubt import Doubt
from track_range.ranging.ranges import Ranges
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks


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
        elif name in ("xyz_m", "motion", "ego_pose"):
            parts["world"] = replace(parts.get("world", result.world), **{name: value})
        elif name in ("warnings", "safety"):
            alarms = parts.get("alarms", result.alarms)
            parts["alarms"] = replace(alarms, **{name: value, f"has_{name}": True})
        elif name in ("ego_mps", "ego_sigma_mps"):
            speed = {name.replace("ego", "speed"): value}
            parts["ego"] = replace(parts.get("ego", result.ego), **speed)
        elif name == "scale_doubt":
            parts["doubt"] = Doubt.of(value)
        else:
            parts[name] = value
    return replace(result, **parts)


def frame_pipeline(
    camera: PinholeCamera, *, calibration_sigma: float = 0.0, **stages: Any
) -> FramePipeline:
    """A pipeline without ego motion and doubt, but with warnings."""
    return FramePipeline(
        ego=EgoStage(),
        doubting=DoubtStage(None, calibration_sigma),
        filtering=FilterStage(camera),
        world=WorldStage(camera),
        alarming=AlarmStage(camera, CollisionWarning()),
        **stages,
    )
