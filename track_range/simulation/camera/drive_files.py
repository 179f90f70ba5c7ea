"""Where a drive's images go: a video, or a folder of numbered PNGs, which loses nothing; and maps of true disparity."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image
from track_range.results.output_files import make_folder, write_bytes
from track_range.simulation.world.truth import SeenObjects
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.video.writer import VideoWriter

NEAR_LOSSLESS_CRF = 10
"""x264's quality: a texture moves against its surface by far less than a tenth of a pixel."""

PNG_EFFORT = 1
"""Of 9: a third larger, and five times faster, than the most."""

EDGE_PX = 1.0
"""A pixel across which the disparity differs by more shows two things: it has none."""

SKIN_M = 0.04
"""How far outside of its 3-D box a drawn point may lie, and how far above the road it must."""


class ImageWriter(Protocol):
    """Takes one eye's images in the order of their times."""

    def write(self, image: Image, time_s: float) -> None:
        """Append an image."""

    def close(self) -> None:
        """Finish."""


class PngFolder:
    """Images as 000000.png, 000001.png, ...: the number is the time in frames, so lost frames leave gaps."""

    def __init__(self, folder: Path, *, fps: float) -> None:
        make_folder(folder)
        for old in folder.glob("*.png"):
            with suppress(OSError):
                old.unlink()
        self._folder, self._fps = folder, fps

    def write(self, image: Image, time_s: float) -> None:
        """Write one image under the number of its time."""
        write_png(self._folder / f"{round(time_s * self._fps):06}.png", image)

    def close(self) -> None:
        """Nothing is left to do."""


def image_writer(path: Path, camera: PinholeCamera, fps: float) -> ImageWriter:
    """A video where `path` ends in .mp4, else a folder of PNGs."""
    if path.suffix == ".mp4":
        return VideoWriter(path, width_px=camera.width_px, height_px=camera.height_px, fps=fps, crf=NEAR_LOSSLESS_CRF)
    return PngFolder(path, fps=fps)


def write_png(path: Path, image: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> None:
    """Write one image, whole or not at all.

    Raises:
        OutputError: the folder cannot be written to.
    """
    _, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, PNG_EFFORT])
    write_bytes(path, encoded.tobytes())


def disparity_map(inverse_depth: FloatArray, rig: StereoRig) -> npt.NDArray[np.uint16]:
    """(H, W) 256 times the disparity that `rig` gives what was drawn, as KITTI stores it; 0 = sky, edge or beyond.

    Args:
        inverse_depth: (2 H, 2 W) 1/m of the samples.
        rig: of the drive.
    """
    height, width = inverse_depth.shape
    samples = inverse_depth.reshape(height // 2, 2, width // 2, 2) * (rig.left.fx_px * rig.baseline_m)
    is_one = samples.max(axis=(1, 3)) - samples.min(axis=(1, 3)) <= EDGE_PX
    mean = samples.mean(axis=(1, 3))
    known = is_one & (samples.min(axis=(1, 3)) > 0) & (mean < 256 - 1 / 256)
    return np.where(known, np.rint(mean * 256), 0).astype(np.uint16)


def object_map(
    inverse_depth: FloatArray, rig: StereoRig, seen: SeenObjects, turns: FloatArray
) -> npt.NDArray[np.uint8]:
    """(H, W) which object each pixel shows: 1 = the nearest of the frame's labels, 0 = none or beyond the 254th.

    A pixel shows an object if the point that was drawn there lies within its 3-D box, above the road.

    Args:
        inverse_depth: (2 H, 2 W) 1/m of the samples.
        rig: of the drive.
        seen: the frame's objects.
        turns: (M, 3, 3) of all road users, from their own axes to the left camera's.
    """
    camera = rig.left
    at = inverse_depth[::2, ::2]
    found = np.zeros(at.shape, np.uint8)
    for number in np.flatnonzero(seen.labels.track_id >= 0)[:254].tolist():
        x1, y1, x2, y2 = (int(edge) for edge in seen.labels.xyxy_px[number])
        column, row = np.meshgrid(np.arange(x1, x2 + 1), np.arange(y1, y2 + 1))
        near = np.maximum(at[row, column], 1e-6)[:, :, None]
        rays = camera.rays(np.stack([column.ravel(), row.ravel()], axis=1).astype(np.float64) - 0.25)
        own = (rays.reshape(*row.shape, 3) / near - seen.labels.location_m[number]) @ turns[seen.row[number]]
        height, width, length = seen.labels.size_hwl_m[number]
        x, y, z = np.moveaxis(own, 2, 0)
        inside = (np.abs(x) < length / 2 + SKIN_M) & (np.abs(z) < width / 2 + SKIN_M)
        inside &= (y > -height - SKIN_M) & (y < -SKIN_M)
        part = found[y1 : y2 + 1, x1 : x2 + 1]
        part[inside & (part == 0)] = number + 1
    return found


def with_even_size(rig: StereoRig) -> StereoRig:
    """The rig with one more column or row where its images have an odd number of them: H.264 wants even ones."""
    camera = rig.left
    wide, high = camera.width_px + camera.width_px % 2, camera.height_px + camera.height_px % 2
    return StereoRig.rectified(replace(camera, width_px=wide, height_px=high), rig.baseline_m)
