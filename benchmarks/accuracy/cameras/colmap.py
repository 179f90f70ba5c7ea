"""Focal lengths by COLMAP (extra `bench`), as a comparison: sequential matching of all images, one
SIMPLE_RADIAL camera that starts with COLMAP's usual focal length of 1.2 widths.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from track_range.foundation.arrays import Image

OVERLAP = 6  # following images with which an image is matched
# smallest angle in degrees between the rays of the first pair, and its largest motion along the
# axis, where COLMAP's 16 and 0.95 find none
AHEAD = 2.0, 1.0


@dataclass(frozen=True, slots=True)
class ColmapResult:
    """The camera of the largest reconstruction; NaN without one."""

    focal_px: float
    k1: float
    n_registered: int
    seconds: float


def colmap_camera(images: Sequence[Image]) -> ColmapResult | None:
    """The camera of images of a drive; None without pycolmap."""
    try:
        import pycolmap  # type: ignore[import-not-found, unused-ignore]
    except ImportError:
        return None
    began_s = time.process_time()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "images").mkdir()
        for number, image in enumerate(images):
            cv2.imwrite(str(folder / "images" / f"{number:05d}.png"), image)
        database = folder / "database.db"
        pycolmap.extract_features(
            database,
            folder / "images",
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=pycolmap.ImageReaderOptions(camera_model="SIMPLE_RADIAL"),
        )
        pairing = pycolmap.SequentialPairingOptions(overlap=OVERLAP, loop_detection=False)
        pycolmap.match_sequential(database, pairing_options=pairing)
        maps: dict[int, Any] = pycolmap.incremental_mapping(database, folder / "images", folder)
        if not maps:  # a drive straight ahead has no first pair of images at the usual angle
            options = pycolmap.IncrementalPipelineOptions()
            options.mapper.init_min_tri_angle, options.mapper.init_max_forward_motion = AHEAD
            maps = pycolmap.incremental_mapping(
                database, folder / "images", folder, options=options
            )
    seconds = time.process_time() - began_s
    if not maps:
        return ColmapResult(float("nan"), float("nan"), 0, seconds)
    best = max(maps.values(), key=lambda found: int(found.num_reg_images()))
    focal_px, _, _, k1 = next(iter(best.cameras.values())).params.tolist()
    return ColmapResult(focal_px, k1, int(best.num_reg_images()), seconds)
