"""depth.tar: depth of all pixels of each frame by every method that measures them, as 16-bit PNGs.

    NAME/000000.png     method NAME, frame 0: depth z in the left camera's frame times 256 per metre,
                        0 = unknown, 65535 = 255.996 m or farther

The images have the resolution of the method's map and cover the whole rectified left image. The
archive grows frame by frame, and can be read up to the last frame of a run that was killed.
"""

import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray32
from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.row_file import RowFile
from track_range.results.formats.run_info import RunInfo

STEPS_PER_M = 256  # as in KITTI's depth maps
_UNKNOWN, _FARTHEST = 0, 65535
_COMPRESSION = 3  # of zlib, 0 to 9: higher ones take twice as long for 3 % less
_END_OF_ARCHIVE = bytes(2 * tarfile.BLOCKSIZE)


class DepthWriter:
    """Writer of depth.tar, frame by frame; frames and methods without depths have no image."""

    files = ("depth.tar",)
    needs_images = True  # rows of a finished run have no pixels

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the archive."""
        self._file = RowFile(folder / self.files[0])

    def write(self, result: FrameResult) -> None:
        """Add the depths of a frame."""
        images = {
            f"{name}/{result.index:06d}.png": depth_png(dense.depth_m())
            for name, dense in result.dense.items()
            if dense.is_depth
        }
        self._file.write(b"".join(_member(name, data) for name, data in images.items()))

    def discard_last(self) -> None:
        """Remove the depths of the last frame."""
        self._file.discard_last()

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """End the archive and close it."""
        self._file.write(_END_OF_ARCHIVE)
        self._file.close()


def depth_png(depth_m: FloatArray32) -> bytes:
    """A PNG file of depths (h, w) in metres, NaN = unknown."""
    steps = np.clip(np.rint(depth_m * STEPS_PER_M), 1, _FARTHEST)
    counts = np.where(np.isnan(steps), _UNKNOWN, steps).astype(np.uint16)
    _, data = cv2.imencode(".png", counts, [cv2.IMWRITE_PNG_COMPRESSION, _COMPRESSION])
    return data.tobytes()


def _member(name: str, data: bytes) -> bytes:
    """A file of a tar archive."""
    header = tarfile.TarInfo(name)
    header.size = len(data)
    padding = bytes(-len(data) % tarfile.BLOCKSIZE)
    return header.tobuf(tarfile.GNU_FORMAT) + data + padding
