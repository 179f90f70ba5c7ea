"""Where a drive's images go: a video, or a folder of numbered PNGs, which loses nothing; and maps of true disparity."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from detection.detections import FloatArray, Image
from stereo.camera import PinholeCamera
from stereo.rig import StereoRig
from track_range.video import VideoWriter
from track_range.written import make_folder, write_bytes

NEAR_LOSSLESS_CRF = 10
"""x264's quality: a texture moves against its surface by far less than a tenth of a pixel."""

PNG_EFFORT = 1
"""Of 9: a third larger, and five times faster, than the most."""

EDGE_PX = 1.0
"""A pixel across which the disparity differs by more shows two things: it has none."""


class EyeWriter(Protocol):
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


def eye_writer(path: Path, camera: PinholeCamera, fps: float) -> EyeWriter:
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


def with_even_size(rig: StereoRig) -> StereoRig:
    """The rig with one more column or row where its images have an odd number of them: H.264 wants even ones."""
    camera = rig.left
    wide, high = camera.width_px + camera.width_px % 2, camera.height_px + camera.height_px % 2
    return StereoRig.rectified(replace(camera, width_px=wide, height_px=high), rig.baseline_m)
