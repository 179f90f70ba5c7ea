"""TrackTable: all live tracks of one stream as parallel arrays, by id; the tracker's own memory, changed in place.

What a track has seen and been called is changed where it stands, and copied only when tracks begin or end; its filter
(every frame), its looks (where they are told) and its past boxes (where the camera moves) become new arrays.
"""

from __future__ import annotations

import numpy as np

from track_range.detection.boxes import xyxy_from_cxcywh
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.tracking import history, motion
from track_range.tracking.gallery import Gallery
from track_range.tracking.history import BoxHistory
from track_range.tracking.motion import MotionNoise


class TrackTable:
    """Rows of tracks, tentative and lost ones too.

    Attributes:
        track_id: (N,) growing.
        filters: their motion.
        past: the last boxes seen.
        votes: (N, classes) sum of scores by class.
        label: (N,) the class with most of them, so that it does not flicker.
        evidence: (N,) sum of all scores.
        score: (N,) of the last box.
        n_hits: (N,) boxes seen.
        is_confirmed: (N,) False = tentative.
        innovation: (N, 2) of the last box's centre, in standard deviations; NaN for a track seen once.
        gallery: their descriptors.
    """

    def __init__(self, *, n_kept: int, gallery: Gallery) -> None:
        self.track_id: IntArray = np.zeros(0, np.int64)
        self.filters = motion.begun(np.zeros((0, 4)), MotionNoise())
        self.past = history.begun(np.zeros((0, 4)), 0.0, n_kept=n_kept)
        self.votes: FloatArray = np.zeros((0, len(ROAD_CLASSES)))
        self.label: IntArray = np.zeros(0, np.int64)
        self.evidence: FloatArray = np.zeros(0)
        self.score: FloatArray = np.zeros(0)
        self.n_hits: IntArray = np.zeros(0, np.int64)
        self.is_confirmed: BoolArray = np.zeros(0, np.bool_)
        self.innovation: FloatArray = np.zeros((0, 2))
        self.gallery = gallery

    def __len__(self) -> int:
        return len(self.track_id)

    @property
    def last_s(self) -> FloatArray:
        """(N,) when each was last seen."""
        return self.past.last_s

    @property
    def last_xyxy_px(self) -> FloatArray:
        """(N, 4) each one's box when it was last seen."""
        return self.past.last_xyxy_px

    def keep(self, alive: BoolArray) -> None:
        """Forget the other tracks."""
        if alive.all():
            return
        self.track_id, self.filters = self.track_id[alive], self.filters.select(alive)
        self.past, self.votes, self.score = self.past.select(alive), self.votes[alive], self.score[alive]
        self.label, self.evidence = self.label[alive], self.evidence[alive]
        self.n_hits, self.is_confirmed = self.n_hits[alive], self.is_confirmed[alive]
        self.innovation, self.gallery = self.innovation[alive], self.gallery.select(alive)

    def see(
        self, rows: IntArray, found: Detections, time_s: float, *, are_running: BoolArray, noise: MotionNoise
    ) -> None:
        """Give each of these tracks its box of this frame; `are_running` (M,) were seen in the frame before, too."""
        before = self.filters.select(rows)
        after, innovation = motion.updated_with_innovations(before, found.xyxy_px, noise)
        self.innovation[rows], mine = innovation[:, :2], self.filters
        mine.value[rows], mine.rate[rows] = after.value, after.rate
        mine.P[rows], mine.height_px[rows] = after.P, after.height_px
        self.past.see(rows, found.xyxy_px, time_s, are_running=are_running)
        self.votes[rows, found.class_id] += found.score
        self.label[rows] = self.votes[rows].argmax(axis=1)
        self.evidence[rows] += found.score
        self.score[rows] = found.score
        self.n_hits[rows] += 1

    def begin(self, first_id: int, found: Detections, time_s: float, *, noise: MotionNoise) -> None:
        """Add a tentative track for each box; ids count from `first_id`."""
        n = len(found)
        ids = np.arange(first_id, first_id + n, dtype=np.int64)
        votes = np.zeros((n, len(ROAD_CLASSES)))
        votes[np.arange(n), found.class_id] = found.score
        self.track_id = np.concatenate([self.track_id, ids])
        self.filters = self.filters.joined(motion.begun(found.xyxy_px, noise))
        self.past = self.past.joined(history.begun(found.xyxy_px, time_s, n_kept=self.past.time_s.shape[1]))
        self.votes = np.concatenate([self.votes, votes])
        self.label = np.concatenate([self.label, found.class_id])
        self.evidence = np.concatenate([self.evidence, found.score])
        self.score = np.concatenate([self.score, found.score])
        self.n_hits = np.concatenate([self.n_hits, np.ones(n, np.int64)])
        self.is_confirmed = np.concatenate([self.is_confirmed, np.zeros(n, np.bool_)])
        self.innovation = np.concatenate([self.innovation, np.full((n, 2), np.nan)])

    def carry(self, now_from_before: FloatArray) -> None:
        """Move everything with the background: predictions, and the boxes seen."""
        self.filters = motion.carried(self.filters, now_from_before)
        boxes_px = xyxy_from_cxcywh(motion.moved(motion.cxcywh(self.past.xyxy_px), now_from_before))
        self.past = BoxHistory(boxes_px, self.past.time_s, self.past.n_running)
