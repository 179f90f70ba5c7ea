"""Frame: what one camera, or two in step, saw at one instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Frame:
    """One instant of a video; the arrays are never written to.

    Attributes:
        index: number of the frame in the left video, from 0, counting also frames that were skipped.
        time_s: seconds from the left video's first frame, from the file's timestamps.
        left: (H, W, 3) uint8 BGR, rectified (one camera: undistorted).
        right: the same of the right eye, rectified to the same rows; None for one camera.
    """

    index: int
    time_s: float
    left: Image
    right: Image | None
