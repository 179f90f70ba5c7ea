"""Textures that are scaled by known factors, and their boxes."""

import cv2
import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.tracking.tracks import Tracks

CAR = ROAD_CLASSES.index("car")
SIZE_PX = np.array([40.0, 32.0])  # of the boxes in the first frame


def texture(seed, sides=(240, 300)):
    rng = np.random.default_rng(seed)
    coarse = cv2.resize(
        rng.uniform(40, 220, (sides[0] // 12, sides[1] // 12)).astype(np.float32), sides[::-1]
    )
    return coarse + cv2.GaussianBlur(rng.normal(0, 40, sides).astype(np.float32), (0, 0), 5)


def scene(objects, *, seed=0, noise=2.0, gain=1.0):
    """(360, 640, 3) image of objects (texture, middle, width and height in px), each over those
    before."""
    rng = np.random.default_rng(seed)
    image = cv2.resize(texture(99), (640, 360))
    for pattern, middle_px, size_px in objects:
        scale = size_px / np.array(pattern.shape[::-1])
        shift = np.asarray(middle_px) - scale * (np.array(pattern.shape[::-1]) - 1) / 2
        placed = np.array([[scale[0], 0, shift[0]], [0, scale[1], shift[1]]])
        # averaged over the area of a pixel: drawn at four times the size
        large = cv2.warpAffine(
            pattern, 4 * placed + [[0, 0, 1.5]] * 2, (2560, 1440), borderValue=-1e4
        )
        small = cv2.resize(large, (640, 360), interpolation=cv2.INTER_AREA)
        image = np.where(small >= 0, small, image)
    grey = np.clip(gain * image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def tracks(middles_px, sizes_px, *, class_id=CAR, noise_px=0.0, seed=0):
    boxes = np.concatenate([middles_px - sizes_px / 2, middles_px + sizes_px / 2], axis=1)
    boxes = boxes + np.random.default_rng(seed).normal(0, noise_px, boxes.shape)
    n = len(boxes)
    return Tracks(
        np.arange(1, n + 1), boxes, np.full(n, class_id), np.ones(n), np.ones(n, np.bool_)
    )
