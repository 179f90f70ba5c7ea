r"""Night lighting: converts a daylight image to an image lit by the ego headlights and lamps.

Light on a surface at depth z:   ambient + beam(x, y) min(1, (12 m / z)^1.3)      beam: wide, low, cut off above
Every visible lamp adds a glow: the lamp, and a halo as caused by lens and air.
"""

from functools import lru_cache

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.world.scene import RoadUser, Scene
from track_range.stereo.geometry.camera import PinholeCamera

# ambient light of a town's sky and distant lamps; blue, green, red
AMBIENT = np.array([0.17, 0.14, 0.13], np.float32)
BEAM = np.array([0.80, 0.92, 1.0], np.float32)  # colour of the headlights; blue, green, red
# headlights have full strength up to here, and fall with this exponent beyond
REACH_M, FADING = 12.0, 1.3
HIDDEN_M = 0.6  # difference in depth above which a nearer surface hides a lamp

RED, WHITE, AMBER = (40.0, 45.0, 255.0), (235.0, 245.0, 255.0), (120.0, 190.0, 255.0)
# relative to the vehicle
LAMP_HEIGHT = {"Car": 0.52, "Van": 0.40, "Truck": 0.22, "Bus": 0.25, "Motorcycle": 0.45}


def lamps_of(
    scene: Scene, time_s: float, *, lamp_heads_m: FloatArray, shift_m: FloatArray
) -> FloatArray:
    """(N, 7) the lamps of vehicles and the street lamps: locations in a camera's frame, colours
    (BGR), radii in m.

    `lamp_heads_m` (N, 3) is in world axes, `shift_m` (3,) the position of the left camera in the
    camera's frame.
    """
    pose = scene.pose(time_s)
    rows: list[tuple[float, ...]] = []
    poses = zip(scene.road_users, scene.location_m(time_s), scene.rotations(time_s), strict=True)
    for user, location, rotation in poses:
        if user.kitti_type in LAMP_HEIGHT and (user.speed_mps > 0 or user.speed_changes):
            rows += _vehicle_lamps(user, location, rotation)
    for head in (lamp_heads_m - pose.position_m) @ pose.camera_from_world.T:
        rows.append((*head.tolist(), *AMBER, 0.22))
    return np.asarray(
        np.array(rows, np.float64).reshape(-1, 7) + np.concatenate([shift_m, np.zeros(4)])
    )


def _vehicle_lamps(
    user: RoadUser, location: FloatArray, rotation: FloatArray
) -> list[tuple[float, ...]]:
    """Rows of a vehicle's lamps: red lamps if its back is visible, white lamps if its front is."""
    height, width, length = user.size_hwl_m
    shows_front = float(rotation[:, 0] @ location) < 0
    x = length / 2 if shows_front else -length / 2
    colour, radius_m = (WHITE, 0.13) if shows_front else (RED, 0.08)
    sides = (0.0,) if user.kitti_type == "Motorcycle" else (-0.4, 0.4)
    lamps = [np.array([x, -height * LAMP_HEIGHT[user.kitti_type], side * width]) for side in sides]
    return [(*(location + rotation @ lamp).tolist(), *colour, radius_m) for lamp in lamps]


def night_image(
    image: Image, inverse_depth: FloatArray, camera: PinholeCamera, lamps: FloatArray
) -> Image:
    """A daylight image as lit by the ego headlights and lamps; the sky does not change.

    `image` is (H, W, 3) uint8, `inverse_depth` (H, W) 1/z in 1/m with 0 = sky; the lamps come from
    `lamps_of`.
    """
    near = cv2.pow(np.minimum(inverse_depth * np.float32(REACH_M), np.float32(1)), FADING)
    strength = headlights(camera) * near
    light = cv2.merge(
        [strength * beam + ambient for beam, ambient in zip(BEAM, AMBIENT, strict=True)]
    )
    light[inverse_depth <= 0] = 1.0
    night = image * light
    for lamp in lamps[lamps[:, 2] > 1.0]:
        _add_glow(night, inverse_depth, camera, lamp)
    return np.asarray(cv2.convertScaleAbs(night), np.uint8)


@lru_cache(maxsize=4)
def headlights(camera: PinholeCamera) -> FloatArray:
    """(H, W) strength of the ego headlights along each pixel's ray, 0 to 1."""
    x = ((np.arange(camera.width_px) - camera.cx_px) / camera.fx_px).astype(np.float32)[None, :]
    y = ((np.arange(camera.height_px) - camera.cy_px) / camera.fy_px).astype(np.float32)[:, None]
    below = 1 / (1 + np.exp(-np.clip((y + 0.03) / 0.015, -30, 30)))
    beam = np.exp(-((x / 0.55) ** 2) - (np.maximum(y - 0.1, 0) / 0.5) ** 2) * (0.08 + 0.92 * below)
    beam.flags.writeable = False
    return np.asarray(beam, np.float32)


def _add_glow(
    image: FloatArray, inverse_depth: FloatArray, camera: PinholeCamera, lamp: FloatArray
) -> None:
    """Add the glow of one lamp (7,) to `image`, unless a nearer surface hides it."""
    location, bgr, radius_m = lamp[:3], lamp[3:6], float(lamp[6])
    xy_px = camera.project(location[None])[0]
    column, row = np.rint(xy_px).astype(int).tolist()
    height, width = image.shape[:2]
    if not (0 <= column < width and 0 <= row < height):
        return
    if inverse_depth[row, column] > 1 / max(float(location[2]) - HIDDEN_M, 0.5):
        return
    core_px = max(1.0, radius_m * camera.fx_px / float(location[2]))
    reach = int(np.ceil(5 * core_px)) + 3
    rows = np.arange(max(0, row - reach), min(height, row + reach + 1))
    columns = np.arange(max(0, column - reach), min(width, column + reach + 1))
    distance2 = ((rows - xy_px[1])[:, None] ** 2 + (columns - xy_px[0])[None, :] ** 2) / core_px**2
    glow = np.exp(-distance2) * 1.2 + 0.25 * np.exp(-distance2 / 8)
    image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += glow[:, :, None] * bgr
