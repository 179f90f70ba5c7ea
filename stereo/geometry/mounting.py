"""Mounting: height and pitch of a camera in its vehicle, and the uncertainty of a fitted focal length."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Mounting:
    """Results of a calibration from the road; the names of the attributes are keys of rig.yaml.

    Attributes:
        focal_sigma: relative standard deviation of the focal length.
        camera_height_m: height of the camera above the road.
        camera_height_sigma_m: its standard deviation.
        pitch_deg: angle of the camera's axis below the horizon.
        pitch_sigma_deg: its standard deviation.
    """

    focal_sigma: float
    camera_height_m: float
    camera_height_sigma_m: float
    pitch_deg: float
    pitch_sigma_deg: float
