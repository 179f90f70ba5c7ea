"""TrackerSettings: every threshold of the tracker, with its unit.

One set for all: chosen on KITTI's cars and pedestrians (RRC boxes of 13 sequences), 6 sequences of MOT15 and MOT17-05.
What differs between detectors and cameras is learnt on the way (`score_threshold`, `noise_level`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from track_range.tracking.association import Classes
from track_range.tracking.confidence_threshold import ScoreThresholdSettings
from track_range.tracking.history import FillGates
from track_range.tracking.motion import MotionNoise
from track_range.tracking.process_noise import NoiseLevelSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class AppearanceGates:
    """Which box may belong to a track by its looks.

    Attributes:
        max_distance: cosine distance (1 - cos) from the nearest of the track's descriptors; 0 = looks are not compared;
            None = what the descriptor says of itself, 0.2 for descriptors of a file.
        max_mahalanobis: squared, from the track's prediction: the chi-square gate, 99.7 % at 4 degrees.
        max_hidden: a box of which a nearer one hides more, as a share of its area, has no looks of its own.
        n_kept: descriptors per track, the running mean among them.
    """

    max_distance: float | None = None
    max_mahalanobis: float = 16.0
    max_hidden: float = 0.5
    n_kept: int = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerSettings:
    """Every threshold of `DeepSortTracker`; scores and IoUs are in [0, 1], times in seconds.

    Attributes:
        low_score: boxes below are not looked at.
        strong_score: from which score on boxes are strong, and start tracks; learnt, see there.
        min_iou: of a strong box with a confirmed or lost track's predicted box.
        weak_min_iou: of a weak box with one; stricter.
        tentative_min_iou: of a strong box with a tentative track, both widened by `tentative_margin`.
        tentative_margin: share of a box's size added on every side, since a new track's speed is not known.
        confirm_hits: boxes a tentative track needs, one per frame, to be confirmed.
        confirm_score: sum of their scores that it needs as well, so that weak starts wait longer; not if one box is
            enough.
        max_break_s: frames without any boxes, which a detector did not look at, do not count for so long: a tentative
            track waits, and a run of frames in a row goes on.
        max_lost_s: a track not seen for longer ends.
        max_spread: so does one whose place is less sure than this, standard deviation in heights of its box.
        score_half_life_s: time in which the score of a predicted box halves.
        classes: which may be one object.
        is_camera_followed: predictions move with the background, where there are images.
        noise, level: of the motion filters.
        appearance: gates of looks.
        fill: when a missing box is predicted.
    """

    low_score: float = 0.1
    strong_score: ScoreThresholdSettings = field(default_factory=ScoreThresholdSettings)
    min_iou: float = 0.2
    weak_min_iou: float = 0.5
    tentative_min_iou: float = 0.3
    tentative_margin: float = 0.3
    confirm_hits: int = 2
    confirm_score: float = 1.5
    max_break_s: float = 1.0
    max_lost_s: float = 4.0
    max_spread: float = 2.0
    score_half_life_s: float = 0.2
    classes: Classes = "similar"
    is_camera_followed: bool = True
    noise: MotionNoise = field(default_factory=MotionNoise)
    level: NoiseLevelSettings = field(default_factory=NoiseLevelSettings)
    appearance: AppearanceGates = field(default_factory=AppearanceGates)
    fill: FillGates = field(default_factory=FillGates)
