"""Findings: what images and boxes show of a run that found no road user, or measured nothing with
its second camera.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from track_range.detection.detections import Detections
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.registry import methods
from track_range.run.reports.report import Reports
from track_range.stereo.geometry.frames import Frame, ImageView
from track_range.stereo.geometry.rig import StereoRig

_INTERVAL = 10  # frames between two whose brightness is measured
_STEP_PX = 16  # between the pixels that are averaged
# numbers of the frames in which road users are sought upside down
_KEPT = (0, 3, 9, 15, 60, 250, 1000)
_KEPT_WIDTH_PX = 900  # width above which they are reduced
# brightness and its standard deviation of images that show nothing; night drives: 36 and 33
_DARK, _UNIFORM = 8.0, 4.0
_MOST = 0.8  # fraction of the images from which on the recording is dark or uniform
# by which the lower third is brighter than the upper one in images that may be upside down
_BRIGHTER = 20.0
# of boxes that show it; by day fewer more are enough
_MIN_SCORE, _MIN_BOXES, _MANY_MORE = 0.5, 4, 3.0
_MIN_DISPARITY_PX = 2.0  # below it, stereo can hardly measure
_MIN_TRACKED = 20  # boxes of which none has a distance that are worth a note
# mean and standard deviation of grey levels 0 to 255; lower minus upper third
Levels = tuple[float, float, float]


class Findings(Reports):
    """Evidence from the images and boxes of a run, whose frames are passed in order.

    At the end, `detect` is used on a few more images (None = not possible); `rig` None = no pair.
    """

    def __init__(self, detect: Callable[[Frame], Detections] | None, rig: StereoRig | None) -> None:
        self._detect, self._rig = detect, rig
        self._n_frames, self._n_boxes = 0, 0
        self._left, self._right, self._kept = list[Levels](), list[Levels](), list[Frame]()
        self._n_measured: dict[str, int] = {}  # number of boxes with a distance, by method
        self._distances_m: list[float] = []  # medians of the frames

    def add(self, result: FrameResult) -> None:
        """Add a frame."""
        if self._n_frames % _INTERVAL == 0:
            self._left.append(_levels(result.left))
            self._right += [] if result.right is None else [_levels(result.right)]
        if self._n_frames in _KEPT:
            step = max(1, result.left.shape[1] // _KEPT_WIDTH_PX)
            small = result.left[::step, ::step].copy()
            self._kept.append(replace(result.frame, left=small, right=None, recorded=None))
        self._n_frames += 1
        self._n_boxes += int(result.tracks.observed.sum())
        for name, ranges in result.ranges.items():
            known_m = ranges.distance_m[np.isfinite(ranges.distance_m)]
            self._n_measured[name] = self._n_measured.get(name, 0) + len(known_m)
            if name == "fused" and len(known_m):
                self._distances_m.append(float(np.median(known_m)))

    def notes(self) -> tuple[str, ...]:
        """Messages for the user at the end of the run."""
        if not self._left:
            return ()
        notes = _problem("", self._left)
        if not notes and self._is_upside_down():
            notes += (
                f"The images appear to be upside down: in a sample of {len(self._kept)} more road "
                "users are found after a rotation by 180 degrees. Rotate the video, for example "
                "with ffmpeg -i IN -vf hflip,vflip OUT.mp4: otherwise few road users are found, "
                "and distances from the road are wrong.",
            )
        if not self._n_boxes and not notes:
            notes += (
                f"No road user was found in {self._n_frames} frames (mean brightness "
                f"{np.mean(self._left, axis=0)[0]:.0f} of 255): try lower --min-score, a larger "
                "--size, all --classes, another --detector, and check that the camera sees the "
                "road.",
            )
        by_pair = [method.name for method in methods() if "right_image" in method.needs]
        silent = [name for name in by_pair if self._n_measured.get(name) == 0]
        if silent and self._n_boxes >= _MIN_TRACKED:
            notes += (
                f"{' and '.join(silent)} measured none of {self._n_boxes} boxes. {self._reason()}",
            )
        return notes

    def _reason(self) -> str:
        """Sentence on the reason why a pair has no distances, as far as the run shows the
        reason.
        """
        if problem := _problem("right ", self._right):
            return problem[0]
        distance_m = float(np.median(self._distances_m or [np.nan]))
        rig = self._rig
        disparity_px = np.nan if rig is None else rig.left.fx_px * rig.baseline_m / distance_m
        if disparity_px < _MIN_DISPARITY_PX:
            return (
                f"The road users are about {distance_m:.0f} m away, where their disparity is "
                f"{disparity_px:.1f} px."
            )
        return (
            "Left and right images do not match on the road users: check that both show the same "
            "scene at the same time, without an obstacle, and that the rig belongs to these "
            "cameras (track-range rig check)."
        )

    def _is_upside_down(self) -> bool:
        """Whether the detector finds more road users in rotated images; tried only if there is
        other evidence.
        """
        detect = self._detect
        if detect is None:
            return False
        is_brighter_below = np.median(self._left, axis=0)[2] > _BRIGHTER
        if not is_brighter_below and self._n_boxes:
            return False
        rotated = [
            replace(frame, left=np.ascontiguousarray(frame.left[::-1, ::-1]))
            for frame in self._kept
        ]
        n_rotated, n_upright = (
            sum(int((detect(frame).score >= _MIN_SCORE).sum()) for frame in frames)
            for frames in (rotated, self._kept)
        )
        return n_rotated >= max(
            _MIN_BOXES, n_upright + 1 if is_brighter_below else _MANY_MORE * n_upright
        )


def _levels(image: ImageView) -> Levels:
    sample = np.asarray(image[::_STEP_PX, ::_STEP_PX], np.float64)
    upper, _, lower = (rows.mean() if rows.size else np.nan for rows in np.array_split(sample, 3))
    return float(sample.mean()), float(sample.std()), float(lower - upper)


def _problem(side: str, levels: list[Levels]) -> tuple[str, ...]:
    """A sentence on images that are mostly dark or uniform."""
    mean, spread, _ = np.array(levels or [(np.inf, np.inf, 0.0)]).T
    is_uniform, is_dark = spread < _UNIFORM, (mean < _DARK) & (spread < _DARK)
    if max(np.mean(is_uniform), np.mean(is_dark)) < _MOST:
        return ()
    kind, causes = (
        ("black", "the lens cap, the exposure")
        if np.mean(is_dark) >= _MOST
        else ("nearly uniform", "the lens")
    )
    return (
        f"The {side}images are {kind} (mean brightness {mean.mean():.0f} of 255, standard "
        f"deviation {spread.mean():.0f}): check {causes} and the decoding of the video.",
    )
