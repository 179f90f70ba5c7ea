"""Frames of a drive whose first track is absent in one of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tests.support.results.frame_results import changed, result
from track_range.pipeline.alarming import Alarms
from track_range.pipeline.world import World
from track_range.ranging.warning.safety import SafetyMeasures
from track_range.ranging.world.object_motion import ObjectMotion
from track_range.results.formats.run_info import RunInfo
from track_range.stereo.geometry.camera import PinholeCamera

CAMERA = PinholeCamera(700.0, 710.0, 20.0, 30.0, 50, 50)
START_S = 1_760_000_000.25
PERIOD_S = 0.1


def info(profile: str = "foxglove", **values: Any) -> RunInfo:
    settings = {"mcap_profile": profile, "mcap_images": True}
    return RunInfo(**{"camera": CAMERA, "rig": None, "fps": 10.0, "settings": settings, **values})


def frame(index: int) -> Any:
    """A frame with tracks 3 (ranged) and 7 (not ranged); track 3 is absent in frame 2."""
    given = result(index)
    image = np.full((50, 50, 3), 8 * index % 256, np.uint8)
    given = replace(given, frame=replace(given.frame, time_s=index * PERIOD_S, left=image))
    if index != 2:
        return given
    tracks = given.tracks.select(np.array([1]))
    rows = {
        name: getattr(given, name)[1:]
        for name in ("closing_mps", "closing_sigma_mps", "ttc_s", "ttc_sigma_s", "xyz_m")
    }
    rows["xy_sigma_m"] = given.world.xy_sigma_m[1:]
    ranges = {name: replace(r, track_id=r.track_id[1:], distance_m=r.distance_m[1:], sigma_m=r.sigma_m[1:])
              for name, r in given.ranges.items()}  # fmt: skip
    warnings = given.warnings.select(slice(1, None))
    safety = SafetyMeasures.unknown(1)
    motion = ObjectMotion(*(getattr(given.motion, name)[1:] for name in ObjectMotion.__slots__))
    alarms = Alarms(warnings, safety, given.alarms.has_warnings, given.alarms.has_safety)
    given = replace(given, world=replace(World.unknown(1), ego_pose=given.ego_pose))
    return changed(given, tracks=tracks, ranges=ranges, motion=motion, alarms=alarms, **rows)
