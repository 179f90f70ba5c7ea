r"""Night: what headlights and lamps make of an image drawn by day.

Light on a surface at depth z:   ambient + beam(x, y) min(1, (12 m / z)^1.3)      beam: wide, low, cut off above
and every lamp that nothing hides is added as a glow:  the lamp itself, and the halo that lens and air make of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.world.scene import RoadUser, Scene
from track_range.stereo.geometry.camera import PinholeCamera

AMBIENT = np.array([0.17, 0.14, 0.13], np.float32)
"""Of a town's sky and distant lamps; blue, green, red."""

BEAM = np.array([0.80, 0.92, 1.0], np.float32)
REACH_M, FADING = 12.0, 1.3
"""Nearer than this light has its full strength; beyond, it falls with this power of the distance."""

HIDDEN_M = 0.6
"""A lamp is hidden by what is this much nearer."""

RED, WHITE, AMBER = (40.0, 45.0, 255.0), (235.0, 245.0, 255.0), (120.0, 190.0, 255.0)
LAMP_HEIGHT = {"Car": 0.52, "Van": 0.40, "Truck": 0.22, "Bus": 0.25, "Motorcycle": 0.45}
"""Share of the height at which the lamps of what has any sit."""


@dataclass(frozen=True, slots=True)
class Lamps:
    """Lights in the left camera's frame, all of which shine this way.

    Attributes:
        at_m: (N, 3) places.
        bgr: (N, 3) colours.
        radius_m: (N,) of the lamp itself.
    """

    at_m: FloatArray
    bgr: FloatArray
    radius_m: FloatArray

    def moved(self, shift_m: FloatArray) -> Lamps:
        """The same from another eye."""
        return Lamps(self.at_m + shift_m, self.bgr, self.radius_m)


def lamps_of(scene: Scene, time_s: float, *, lamp_heads_m: FloatArray) -> Lamps:
    """The lamps that shine towards the camera: of vehicles, and street lamps (their heads in the world's axes)."""
    pose = scene.pose(time_s)
    rows: list[tuple[float, ...]] = []
    for user, location, turn in zip(scene.road_users, scene.location_m(time_s), scene.turns(time_s), strict=True):
        if user.kitti_type in LAMP_HEIGHT and (user.speed_mps > 0 or user.speed_changes):
            rows += _own_lamps(user, location, turn)
    for head in (lamp_heads_m - pose.place_m) @ pose.camera_from_world.T:
        rows.append((*head.tolist(), *AMBER, 0.22))
    table = np.array(rows, np.float64).reshape(-1, 7)
    return Lamps(table[:, :3], table[:, 3:6], table[:, 6])


def _own_lamps(user: RoadUser, location: FloatArray, turn: FloatArray) -> list[tuple[float, ...]]:
    """Two lamps, red where its back is seen, white where its front is."""
    height, width, length = user.size_hwl_m
    shows_front = float(turn[:, 0] @ location) < 0
    x = length / 2 if shows_front else -length / 2
    colour, radius_m = (WHITE, 0.13) if shows_front else (RED, 0.08)
    sides = (0.0,) if user.kitti_type == "Motorcycle" else (-0.4, 0.4)
    own = [np.array([x, -height * LAMP_HEIGHT[user.kitti_type], side * width]) for side in sides]
    return [(*(location + turn @ place).tolist(), *colour, radius_m) for place in own]


def lit(image: Image, inverse_depth: FloatArray, camera: PinholeCamera, lamps: Lamps) -> Image:
    """An image drawn by day, as the own headlights and the given lamps show it; the sky stays as it is.

    Args:
        image: (H, W, 3) uint8; not written to.
        inverse_depth: (H, W) 1/m, 0 = sky.
        camera: of this image.
        lamps: in this eye's frame.
    """
    near = cv2.pow(np.minimum(inverse_depth * np.float32(REACH_M), np.float32(1)), FADING)
    strength = headlights(camera) * near
    light = cv2.merge([strength * beam + ambient for beam, ambient in zip(BEAM, AMBIENT, strict=True)])
    light[inverse_depth <= 0] = 1.0
    shown = image * light
    for place, colour, radius_m in zip(lamps.at_m, lamps.bgr, lamps.radius_m.tolist(), strict=True):
        if place[2] > 1.0:
            _add_glow(shown, inverse_depth, camera, (place, colour, radius_m))
    return np.asarray(cv2.convertScaleAbs(shown), np.uint8)


@lru_cache(maxsize=4)
def headlights(camera: PinholeCamera) -> FloatArray:
    """(H, W) 0..1: how much of the own beam goes along each pixel's ray."""
    x = ((np.arange(camera.width_px) - camera.cx_px) / camera.fx_px).astype(np.float32)[None, :]
    y = ((np.arange(camera.height_px) - camera.cy_px) / camera.fy_px).astype(np.float32)[:, None]
    below = 1 / (1 + np.exp(-np.clip((y + 0.03) / 0.015, -30, 30)))
    beam = np.exp(-((x / 0.55) ** 2) - (np.maximum(y - 0.1, 0) / 0.5) ** 2) * (0.08 + 0.92 * below)
    beam.flags.writeable = False
    return np.asarray(beam, np.float32)


def _add_glow(
    shown: FloatArray, inverse_depth: FloatArray, camera: PinholeCamera, lamp: tuple[FloatArray, FloatArray, float]
) -> None:
    """Add one lamp, unless something stands before it (in place)."""
    place, colour, radius_m = lamp
    at_px = camera.project(place[None])[0]
    column, row = np.rint(at_px).astype(int).tolist()
    height, width = shown.shape[:2]
    if not (0 <= column < width and 0 <= row < height):
        return
    if inverse_depth[row, column] > 1 / max(float(place[2]) - HIDDEN_M, 0.5):
        return
    core_px = max(1.0, radius_m * camera.fx_px / float(place[2]))
    reach = int(np.ceil(5 * core_px)) + 3
    rows = np.arange(max(0, row - reach), min(height, row + reach + 1))
    columns = np.arange(max(0, column - reach), min(width, column + reach + 1))
    away2 = ((rows - at_px[1])[:, None] ** 2 + (columns - at_px[0])[None, :] ** 2) / core_px**2
    glow = np.exp(-away2) * 1.2 + 0.25 * np.exp(-away2 / 8)
    shown[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += glow[:, :, None] * colour
