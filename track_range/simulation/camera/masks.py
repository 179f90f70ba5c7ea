"""Masks of a drive: the heads and number plates that are visible in the left images, as lossless PNG images.

masks/000000.png      uint8 by pixel: 0 neither, 1 head, 2 number plate (`faces.IdentifyingPart`)
mask_ids/000000.png   uint16 by pixel: 1 + track id of the road user (of truth.txt), 0 = neither

A pixel belongs to a part if at least `MIN_SAMPLES` of its four samples show it, without lens blur and noise. Files are
numbered by frame of the left video, without gaps for dropped frames.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from track_range.simulation.camera.drive_files import make_png_folder, write_png
from track_range.simulation.world.scene import Scene

MIN_SAMPLES = 2  # minimum number of a pixel's four samples that show a part


class MaskFolder:
    """Writes the masks of the frames in order; those of an earlier drive are removed."""

    def __init__(self, folder: Path, scene: Scene) -> None:
        self._folders = (folder / "masks", folder / "mask_ids")
        self._track_id = np.array([user.track_id for user in scene.road_users], np.int64)
        self._n_frames = 0
        for path in self._folders:
            make_png_folder(path)

    def write(self, labels: npt.NDArray[np.uint16]) -> None:
        """Write the masks of the next frame from `Renderer.render_with_labels`."""
        part, row = masks_of(labels)
        number = np.where(part > 0, self._track_id[row] + 1, 0) if len(self._track_id) else row
        name = f"{self._n_frames:06}.png"
        write_png(self._folders[0] / name, part)
        write_png(self._folders[1] / name, number.astype(np.uint16))
        self._n_frames += 1


def masks_of(labels: npt.NDArray[np.uint16]) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
    """(H, W) part of each pixel, 0 to 2, and (H, W) row of its road user in the scene, from samples (2 H, 2 W)."""
    height, width = labels.shape
    samples = labels.reshape(height // 2, 2, width // 2, 2).transpose(0, 2, 1, 3).reshape(height // 2, width // 2, 4)
    label = np.sort(samples, axis=2)[:, :, 4 - MIN_SAMPLES].astype(np.int64)
    is_part = label > 0
    part = np.where(is_part, (label - 1) % 2 + 1, 0).astype(np.uint8)
    return part, np.where(is_part, (label - 1) // 2, 0)
