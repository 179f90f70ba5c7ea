"""RightCamera: how the right camera of a pair moved against its rig, and the correction of its
images.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.stereo.alignment.right_view import RightView
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame, ImageView, whole_image
from track_range.stereo.right_camera.change_filter import Changes

PITCH, ROLL, ZOOM, OFFSET, BOW = range(5)  # changes
_MIN_SIGMAS, _MIN_CHANGE_PX = 3.0, 0.12  # of a change that is corrected
_IS_HIT = 0.5  # probability of a hit in the last frame
_WARPED_PX = 0.8  # change from which the right image is warped
# Disparity error per px of rows if the image is shifted rather than turned, and that of the offset
# by the flow which follows from it: on a simulated drive 0.03 half-way to the edges, and 0.07.
_BY_ROWS = 0.05
_NO_BASE = np.eye(3)


@dataclass(frozen=True, slots=True)
class RightCamera:
    """The right camera relative to the alignment of the frames."""

    camera: PinholeCamera
    own: Alignment = field(default_factory=Alignment)  # of the frame
    change: Changes = field(
        default_factory=lambda: changes_of(np.zeros(5))
    )  # pitch, roll, zoom, offset and bow in px
    # (3, 3) correction of directions before it: what earlier movements left
    base: FloatArray = field(default_factory=lambda: _NO_BASE)
    is_lost: bool = False  # whether left and right do not match

    # (5,) the changes that are significant; others are 0
    applied_px: FloatArray = field(init=False)
    is_warped: bool = field(init=False)  # whether right images are warped

    def __post_init__(self) -> None:
        mean, sigma, _ = self.change
        is_clear = np.abs(mean) > np.maximum(_MIN_SIGMAS * sigma, _MIN_CHANGE_PX)
        applied_px = np.where(is_clear, mean, 0.0)
        object.__setattr__(self, "applied_px", applied_px)
        is_far = max(map(abs, applied_px[:BOW].tolist())) > _WARPED_PX
        object.__setattr__(self, "is_warped", is_far or self.has_base)

    @property
    def has_base(self) -> bool:
        """Whether earlier movements are corrected."""
        return self.base is not _NO_BASE and bool((self.base != _NO_BASE).any())

    @property
    def is_hit(self) -> bool:
        """Whether the last frame showed a hit."""
        return bool((self.change.hit > _IS_HIT).any())

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) from directions in the rectified right image to corrected directions."""
        if not self.is_warped:
            return np.eye(3)
        pitch_px, roll_px, zoom_px, offset_px, _ = self.applied_px.tolist()
        half_px = self.camera.width_px / 2
        view = RightView(
            pitch_px,
            math.degrees(roll_px / half_px),
            math.exp(zoom_px / half_px),
            -math.degrees(math.atan(offset_px / self.camera.fx_px)),
        )
        return view.matrix(self.camera) @ self.base

    def moved_from(self, before: RightCamera, right_px: FloatArray) -> FloatArray:
        """(N, 2) corrected points of a right image that `before` has corrected."""
        if not (self.is_warped or before.is_warped):
            return right_px
        matrix = self.matrix @ np.linalg.inv(before.matrix)
        return self.camera.project(self.camera.rays(right_px) @ matrix.T)

    @property
    def alignment(self) -> Alignment:
        """The correction of the disparities of corrected right images."""
        pitch_px, _, _, offset_px, bow_px = applied_px = self.applied_px.tolist()
        if self.is_warped:
            offset_px = 0.0
        mean, sigma, _ = self.change
        withheld_px = [
            math.hypot(0.0 if of_applied else of_mean, of_sigma)
            for of_applied, of_mean, of_sigma in zip(
                applied_px, mean.tolist(), sigma.tolist(), strict=True
            )
        ]
        # zoom and bow act at the edges
        at_edges_px = math.hypot(withheld_px[ZOOM], withheld_px[BOW]) / math.sqrt(3.0)
        extra_px = math.hypot(withheld_px[OFFSET], _BY_ROWS * pitch_px, at_edges_px)
        bow_of_offset = (self.camera.width_px / 2 / self.camera.fx_px) ** 2
        return replace(
            self.own,
            offset_px=self.own.offset_px + offset_px,
            curvature_px=self.own.curvature_px + bow_px + bow_of_offset * offset_px,
            residual_px=math.hypot(self.own.residual_px, extra_px),
        )

    def warped(self, right: ImageView) -> Image:
        """All of the corrected right image."""
        if not self.is_warped:
            return whole_image(right)
        K = self.camera.matrix
        H = K @ self.matrix @ np.linalg.inv(K)
        return np.asarray(
            cv2.warpPerspective(
                whole_image(right),
                H,
                self.camera.size_px,
                flags=cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            ),
            np.uint8,
        )

    def corrected(self, frame: Frame) -> Frame:
        """A frame with the correction in its images and in its alignment."""
        if frame.right is None or self.is_lost:
            return replace(frame, right=None)
        right = self.warped(frame.right) if self.is_warped else frame.right
        return replace(frame, right=right, alignment=self.alignment)


def changes_of(mean: FloatArray) -> Changes:
    """Changes (5,) that are known exactly."""
    return Changes(mean, np.zeros(5), np.zeros(4))
