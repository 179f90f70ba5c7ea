"""Images of a drive with a part that does not move with the scene, as users record them.

From a third of the drive on, and for a third of it where the part passes, both images of a pair get:

    clouds  texture without motion above the horizon
    flat    the same, above a road without texture
    lead    the rear of a vehicle at our own speed, without a box
    bonnet  the own bonnet, with reflections, during the whole drive
    text    lines of text burnt in, during the whole drive
"""

from collections.abc import Sequence

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.stereo.geometry.frames import Frame

EDITS = ("none", "clouds", "flat", "lead", "bonnet", "text")
_SKY, _FLAT = 0.52, 0.62  # fractions of the height: below the horizon, and where the road is flat
_BONNET = 0.8  # fraction of the height from which the bonnet hides the road
_REAR = (0.1, 0.2, 0.8)  # of the height and width: top, left and right edge of the vehicle ahead
_REAR_DISPARITY_PX = 40
_TEXT = "2026-11-29 13:50:44  N 48.1234  E 11.4321  088 KM/H  FRONT CAMERA"


def edited(frames: Sequence[Frame], edit: str) -> list[Frame]:
    """The frames of a drive after one of `EDITS`."""
    n = len(frames)
    is_late = [edit in ("bonnet", "text") or 3 * number >= n for number in range(n)]
    if edit == "lead":
        is_late = [n <= 3 * number < 2 * n for number in range(n)]
    height, width = frames[0].left.shape[:2]
    noise = np.random.default_rng(0).integers(0, 255, (height, width)).astype(np.uint8)
    texture = np.asarray(cv2.GaussianBlur(noise, (0, 0), 2.0), np.uint8)
    return [
        frame if edit == "none" or not late else _edited(frame, edit, texture)
        for frame, late in zip(frames, is_late, strict=True)
    ]


def _edited(frame: Frame, edit: str, texture: Image) -> Frame:
    left = _image(frame.left, edit, texture, 0)
    right = None
    if isinstance(frame.right, np.ndarray):
        right = _image(frame.right, edit, texture, _REAR_DISPARITY_PX)
    return Frame(frame.index, frame.time_s, left, right)


def _image(image: Image, edit: str, texture: Image, disparity_px: int) -> Image:
    shown = image.copy()
    height, width = image.shape[:2]
    painted = texture if image.ndim == 2 else np.repeat(texture[:, :, None], 3, axis=2)
    sky = int(_SKY * height)
    if edit == "flat":
        weight = np.clip(_below(height, _SKY) / (_FLAT - _SKY), 0.0, 1.0)
        weight = weight.reshape(-1, *[1] * (image.ndim - 1))
        blurred = cv2.GaussianBlur(image, (0, 0), 12.0)
        shown = np.asarray((1 - weight) * image + weight * blurred, np.uint8)
    if edit in ("clouds", "flat"):
        shown[:sky] = painted[:sky]
    if edit == "lead":
        top, left, right = (
            int(part * side) for part, side in zip(_REAR, (height, width, width), strict=True)
        )
        shown[top:, left - disparity_px : right - disparity_px] = painted[top:, left:right]
    if edit == "bonnet":
        shown[int(_BONNET * height) :] = painted[int(_BONNET * height) :]
    if edit == "text":
        for row in range(4):
            for y in (22 + 20 * row, height - 8 - 20 * row):
                cv2.putText(shown, _TEXT, (5, y), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255,) * 3, 2)
    return shown


def _below(height: int, fraction: float) -> FloatArray:
    """(height,) parts of the height by which rows lie below a fraction of it."""
    return np.arange(height) / height - fraction
