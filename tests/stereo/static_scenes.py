"""Points of static scenes before and after a motion of the camera."""

import math

import numpy as np

from track_range.stereo.geometry.camera import PinholeCamera

CAMERA = PinholeCamera(360.0, 360.0, 310.0, 90.0, width_px=620, height_px=188)
NOISE = 0.15 / 360


def yawed(angle_rad):
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])


def static_scene(motion, n=200, seed=0, noise=NOISE):
    """Rays before, inverse depths, and rays now of random points of a static scene."""
    rng = np.random.default_rng(seed)
    pixels = np.stack([rng.uniform(0, 620, n), rng.uniform(0, 188, n)], axis=1)
    rays, rho = CAMERA.rays(pixels), 1 / rng.uniform(5, 60, n)
    now = motion.moved(rays, rho)
    now = now / now[:, 2:]
    now[:, :2] += noise * rng.normal(size=(n, 2))
    return rays, rho, now
