"""SortTracker: boxes to identities by motion and overlap; weak boxes keep a track alive but do not start one.

    found boxes --- strong ---> 1. confirmed and lost tracks ---> 3. tentative tracks ---> 4. new tentative tracks
                +-- weak ----> 2. tracks seen one frame ago

After SORT (Bewley et al., 2016), ByteTrack (Zhang et al., 2022) and C-BIoU (Yang et al., 2023). What is reported is the
box that was detected, not the filter's opinion of it, whose edges lag; missing boxes are `tracking.history`'s.
No chi-square gate stands beside the IoU: boxes cut by the image border or by an occluder break the filter's model. The
thresholds were chosen on KITTI's, MOT15's and MOT17's stored boxes, the sequences named in `tracking.history`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from detection.boxes import are_sound
from detection.classes import ROAD_CLASSES
from detection.detections import BoolArray, Detections, FloatArray, Image, IntArray
from tracking import history, motion
from tracking.association import are_compatible, assigned, iou_cost
from tracking.history import BoxHistory, FillGates
from tracking.motion import BoxFilters, MotionNoise
from tracking.tracks import Tracks


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerSettings:
    """Every threshold of `SortTracker`; scores and IoUs are in [0, 1], times in seconds.

    Attributes:
        low_score: boxes below are not looked at.
        high_score: boxes from here on are strong, those below weak.
        new_track_score: a strong box that nobody claims starts a track from here on.
        min_iou: of a strong box with a confirmed or lost track's predicted box.
        weak_min_iou: of a weak box with a track seen in the frame before; stricter.
        tentative_min_iou: of a strong box with a tentative track, both widened by `tentative_margin`.
        tentative_margin: share of a box's size added on every side, since a new track's speed is not known.
        confirm_hits: boxes a tentative track needs, one per frame, to be confirmed.
        confirm_score: sum of their scores that it needs as well, so that weak starts wait longer.
        max_lost_s: a track not seen for longer ends.
        score_half_life_s: time in which the score of a predicted box halves.
        noise: of the motion filters.
        fill: when a missing box is predicted.
    """

    low_score: float = 0.1
    high_score: float = 0.4
    new_track_score: float = 0.4
    min_iou: float = 0.2
    weak_min_iou: float = 0.5
    tentative_min_iou: float = 0.3
    tentative_margin: float = 0.3
    confirm_hits: int = 2
    confirm_score: float = 1.5
    max_lost_s: float = 1.2
    score_half_life_s: float = 0.2
    noise: MotionNoise = field(default_factory=MotionNoise)
    fill: FillGates = field(default_factory=FillGates)


@dataclass(frozen=True, slots=True)
class _TrackTable:
    """All live tracks as parallel arrays, tentative and lost ones too.

    Attributes:
        track_id: (N,).
        filters: their motion.
        history: their last boxes.
        votes: (N, classes) sum of scores by class; the label is the class with most, so that it does not flicker.
        score: (N,) of the last box.
        n_hits: (N,) boxes seen.
        confirmed: (N,) False = tentative.
    """

    track_id: IntArray
    filters: BoxFilters
    history: BoxHistory
    votes: FloatArray
    score: FloatArray
    n_hits: IntArray
    confirmed: BoolArray

    def __len__(self) -> int:
        return len(self.track_id)

    @property
    def class_id(self) -> IntArray:
        return np.asarray(self.votes.argmax(axis=1), np.int64)

    def select(self, keep: BoolArray | IntArray) -> _TrackTable:
        return _TrackTable(
            self.track_id[keep],
            self.filters.select(keep),
            self.history.select(keep),
            self.votes[keep],
            self.score[keep],
            self.n_hits[keep],
            self.confirmed[keep],
        )

    def joined(self, other: _TrackTable) -> _TrackTable:
        return _TrackTable(
            np.concatenate([self.track_id, other.track_id]),
            self.filters.joined(other.filters),
            self.history.joined(other.history),
            np.concatenate([self.votes, other.votes]),
            np.concatenate([self.score, other.score]),
            np.concatenate([self.n_hits, other.n_hits]),
            np.concatenate([self.confirmed, other.confirmed]),
        )


class SortTracker:
    """Tracks one stream of frames; ids count from 1 and the same input gives the same output.

    Tracks are confirmed at once in the first frame; later they are tentative, and not reported, until
    `TrackerSettings.confirm_hits` and `confirm_score` are reached. Boxes that are not finite, or have no area or score,
    are ignored.
    """

    def __init__(self, settings: TrackerSettings | None = None) -> None:
        self._settings = settings or TrackerSettings()
        self._next_id = 1
        self._last_s = -np.inf
        self._table = self._born(Detections.empty(), 0.0)

    def update(self, detections: Detections, time_s: float, image: Image | None) -> Tracks:
        """The confirmed tracks at `time_s`, by id: seen ones, and lost ones whose box could be predicted.

        `image` gives the image's border; None = not known, so boxes that leave the image may be predicted for a while.

        Raises:
            ValueError: time does not go forward.
        """
        if not self._last_s < time_s < np.inf:
            raise ValueError(f"time must go forward: {time_s} s after {self._last_s} s")
        sound = are_sound(detections.xyxy_px) & (detections.score >= self._settings.low_score)
        found = detections.select(sound)
        table = self._moved_to(time_s)
        rows, columns = self._pairs(table, found)
        seen = self._seen(table.select(rows), found.select(columns), time_s)
        unclaimed = _without(len(found), columns) & (found.score >= self._settings.new_track_score)
        born = self._born(found.select(unclaimed), time_s)
        missing = table.select(_without(len(table), rows) & table.confirmed)
        self._table = seen.joined(born).joined(missing)
        self._last_s = time_s
        return self._reported(seen.joined(born), missing, time_s, image)

    def _moved_to(self, time_s: float) -> _TrackTable:
        """The tracks that are still alive, with their filters predicted."""
        live = self._table.select(time_s - self._table.history.last_s <= self._settings.max_lost_s)
        if len(live) == 0:
            return live
        filters = motion.predicted(live.filters, time_s - self._last_s, self._settings.noise)
        return _TrackTable(live.track_id, filters, live.history, live.votes, live.score, live.n_hits, live.confirmed)

    def _pairs(self, table: _TrackTable, found: Detections) -> tuple[IntArray, IntArray]:
        """Rows of tracks and of boxes that belong together, in three stages, each with what the ones before left."""
        keep = self._settings
        boxes, class_id = table.filters.xyxy_px, table.class_id
        strong, recent = found.score >= keep.high_score, table.history.last_s == self._last_s
        stages = (
            (table.confirmed, strong, keep.min_iou, 0.0),
            (table.confirmed & recent, ~strong, keep.weak_min_iou, 0.0),
            (~table.confirmed, strong, keep.tentative_min_iou, keep.tentative_margin),
        )
        rows, columns = np.zeros(0, np.int64), np.zeros(0, np.int64)
        for tracks_wanted, boxes_wanted, min_iou, margin in stages:
            i = np.flatnonzero(tracks_wanted & _without(len(table), rows))
            j = np.flatnonzero(boxes_wanted & _without(len(found), columns))
            cost = iou_cost(boxes[i], found.xyxy_px[j], margin=margin)
            cost[~are_compatible(class_id[i], found.class_id[j])] = np.inf
            r, c = assigned(cost, max_cost=1 - min_iou)
            rows, columns = np.append(rows, i[r]), np.append(columns, j[c])
        return rows, columns

    def _seen(self, table: _TrackTable, found: Detections, time_s: float) -> _TrackTable:
        """The tracks after each has got its box."""
        keep = self._settings
        votes, n_hits = table.votes + _votes(found), table.n_hits + 1
        sure = (n_hits >= keep.confirm_hits) & (votes.sum(axis=1) >= keep.confirm_score)
        return _TrackTable(
            table.track_id,
            motion.updated(table.filters, found.xyxy_px, keep.noise),
            table.history.appended(found.xyxy_px, time_s, previous_s=self._last_s),
            votes,
            found.score,
            n_hits,
            table.confirmed | sure,
        )

    def _born(self, found: Detections, time_s: float) -> _TrackTable:
        """New tracks of boxes that belong to nobody."""
        n, keep = len(found), self._settings
        track_id = self._next_id + np.arange(n, dtype=np.int64)
        self._next_id += n
        first_frame = self._last_s == -np.inf
        return _TrackTable(
            track_id,
            motion.begun(found.xyxy_px, keep.noise),
            history.begun(found.xyxy_px, time_s, n_kept=keep.fill.n_kept),
            _votes(found),
            found.score,
            np.ones(n, np.int64),
            np.full(n, first_frame or keep.confirm_hits <= 1),
        )

    def _reported(self, seen: _TrackTable, missing: _TrackTable, time_s: float, image: Image | None) -> Tracks:
        """Confirmed tracks by id: boxes as detected, then what can be predicted of the missing."""
        image_hw = None if image is None else (image.shape[0], image.shape[1])
        rows, boxes = history.filled(missing.history, time_s, gates=self._settings.fill, image_hw=image_hw)
        missing, seen = missing.select(rows), seen.select(seen.confirmed)
        age_s = time_s - missing.history.last_s
        faded = missing.score * 0.5 ** (age_s / self._settings.score_half_life_s)
        track_id = np.concatenate([seen.track_id, missing.track_id])
        tracks = Tracks(
            track_id,
            np.concatenate([seen.history.last_xyxy_px, boxes]),
            np.concatenate([seen.class_id, missing.class_id]),
            np.concatenate([seen.score, faded]),
            np.arange(len(track_id)) < len(seen),
        )
        return tracks.select(np.argsort(track_id))


def _without(n: int, taken: IntArray) -> BoolArray:
    """(n,) True but for the indices taken."""
    free = np.ones(n, np.bool_)
    free[taken] = False
    return free


def _votes(found: Detections) -> FloatArray:
    """(N, classes) each box's score in its class's column."""
    votes = np.zeros((len(found), len(ROAD_CLASSES)))
    votes[np.arange(len(found)), found.class_id] = found.score
    return votes
