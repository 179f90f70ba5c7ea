"""Exact lines along a straight road, projected by a pinhole camera, as pixels and as a picture."""

import cv2
import numpy as np

HW = (360, 640)
HORIZON_PX, CENTRE_PX, FOCAL_PX, HEIGHT_M = 170.0, 320.0, 500.0, 1.5


def road_x_px(x_m, y_px):
    """x of a line along the road, `x_m` to the right of the camera: cx + x_m / height * (y -
    horizon)."""
    return CENTRE_PX + x_m / HEIGHT_M * (y_px - HORIZON_PX)


def width_px(y_px, lane_m=3.5):
    return lane_m / HEIGHT_M * (y_px - HORIZON_PX)


def distance_m(y_px):
    return FOCAL_PX * HEIGHT_M / (y_px - HORIZON_PX)


def row_px(distance):
    return HORIZON_PX + FOCAL_PX * HEIGHT_M / distance


def line_pixels(x_m, *, top_px=200.0, bottom_px=355.0, step_px=2.0):
    y = np.arange(top_px, bottom_px, step_px)
    return np.stack([road_x_px(x_m, y), y], axis=1)


def picture(*lines_m, seed=0, dashed=(), hw=HW, noise=3.0):
    """Asphalt with white lines of 0.15 m along the road; those in `dashed` have dashes of 4 m every
    12 m."""
    y, x = np.mgrid[: hw[0], : hw[1]].astype(np.float64)
    below = np.maximum(y - HORIZON_PX, 0.5)
    across_m = (x - CENTRE_PX) * HEIGHT_M / below
    grey = np.where(y > HORIZON_PX, 90.0, 160.0)
    for line_m in lines_m:
        paint = (np.abs(across_m - line_m) < 0.075) & (y > HORIZON_PX + 3)
        if line_m in dashed:
            paint &= distance_m(HORIZON_PX + below) % 12 < 4
        grey[paint] = 210.0
    grey = cv2.blur(grey + np.random.default_rng(seed).normal(0, noise, hw), (3, 3))
    return np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
