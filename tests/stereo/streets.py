"""Images of a street without end: a road and a wall on either side, with known texture."""

import cv2
import numpy as np

from track_range.stereo.geometry.camera import PinholeCamera

CAMERA = PinholeCamera(240.0, 240.0, 240.0, 135.0, 480, 270)
COLUMN, ROW = np.meshgrid(np.arange(480.0), np.arange(270.0))
RAYS = CAMERA.rays(np.stack([COLUMN.ravel(), ROW.ravel()], axis=1))
HEIGHT_M, WALL_M, CELL_M = 1.8, 9.0, 0.15
TEXTURE = cv2.GaussianBlur(
    np.random.default_rng(3).uniform(0, 255, (512, 512)).astype(np.float32), (0, 0), 0.8
)


def street(mounting, z_m, heading_rad=0.0, x_m=0.0):
    """The image (270, 480) of a mounted `CAMERA` at `z_m` along the street and `x_m` to the
    right of its middle, headed to the right."""
    turn = cv2.Rodrigues(np.array([0.0, heading_rad, 0.0]))[0]
    x, y, z = turn @ mounting.travel_from_camera @ RAYS.T
    to_road = HEIGHT_M / np.maximum(y, 1e-9)
    to_wall = (WALL_M - x_m * np.sign(x)) / np.maximum(np.abs(x), 1e-9)
    distance_m = np.minimum(to_road, to_wall)
    along_m = z_m + distance_m * z
    across_m = np.where(to_road < to_wall, x_m + distance_m * x, 40.0 * np.sign(x) + distance_m * y)
    maps = [np.asarray(m / CELL_M % 511, np.float32).reshape(270, 480) for m in (across_m, along_m)]
    grey = cv2.remap(TEXTURE, *maps, cv2.INTER_LINEAR)
    fade = np.minimum(1.0, 25.0 / distance_m).reshape(270, 480)  # far texture would be aliased
    return np.asarray(128 + fade * (grey - 128), np.uint8)
