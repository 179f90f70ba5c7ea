"""Mounting: height and pitch of a camera in its vehicle, and the uncertainty of a fitted focal length."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Mounting:
    """Results of a calibration from the road; the names of the attributes are keys of rig.yaml."""

    focal_sigma: float  # relative standard deviation of the focal length
    camera_height_m: float  # height of the camera above the road
    camera_height_sigma_m: float  # its standard deviation
    pitch_deg: float  # angle of the camera's axis below the horizon
    pitch_sigma_deg: float  # its standard deviation

    @property
    def sentence(self) -> str:
        """Message for the user."""
        height, pitch = self.camera_height_m, self.pitch_deg
        return (
            f"Calibrated on the road: the focal length is known within {100 * self.focal_sigma:.1f} %, which is part "
            f"of the sigma of every distance; camera height {height:.2f} ± {self.camera_height_sigma_m:.2f} m, pitch "
            f"{pitch:+.1f} ± {self.pitch_sigma_deg:.1f} degrees (positive = down)."
        )
