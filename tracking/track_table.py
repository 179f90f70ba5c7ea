"""TrackTable: all live tracks of one stream as parallel arrays, by id; the tracker's state, changed
in place.

Arrays are copied when tracks start or end; the filters are replaced in every frame, the gallery
where there are embeddings.
"""

import numpy as np
from scipy.special import ndtr

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.tracking import history, motion
from track_range.tracking.appearance.gallery import Gallery
from track_range.tracking.motion import MotionNoise

# Lead in votes that changes a class, in standard deviations of the difference of random votes. Of
# tracks with a random one of two classes in each frame, 0.2 % change more than once in 100 frames;
# nine votes correct three wrong ones.
_MIN_LEAD = 1.5
_LEAST_VOTE = 1e-9  # of a box with a score of 0, which has a class too
_LEAST_PROBABILITY = 0.003  # of another class; less is no doubt
_PERSON = ROAD_CLASSES.index("person")


class TrackTable:
    """Confirmed, tentative and lost tracks."""

    def __init__(self, *, n_boxes: int, n_embeddings: int) -> None:
        """An empty table that stores `n_boxes` boxes and `n_embeddings` embeddings per track."""
        self.track_id: IntArray = np.zeros(0, np.int64)  # (N,) ascending
        self.filters = motion.initiate(np.zeros((0, 4)), MotionNoise())  # motion filters
        # the last detected boxes
        self.history = history.initiate(np.zeros((0, 4)), 0.0, n_kept=n_boxes)
        # (N, classes) sum of scores
        self.class_votes: FloatArray = np.zeros((0, len(ROAD_CLASSES)))
        # (N,) the class with the most votes, with hysteresis, so that it does not flicker
        self.class_id: IntArray = np.zeros(0, np.int64)
        self.score_sum: FloatArray = np.zeros(0)  # (N,) sum of the scores of all detections
        self.score: FloatArray = np.zeros(0)  # (N,) score of the last detection
        self.n_hits: IntArray = np.zeros(0, np.int64)  # (N,) number of detections
        self.is_confirmed: BoolArray = np.zeros(0, np.bool_)  # (N,) False = tentative
        # (N, 2) of the last detection's centre, in standard deviations; NaN = detected once
        self.innovation: FloatArray = np.zeros((0, 2))
        self.gallery = Gallery.empty(nn_budget=n_embeddings)

    def __len__(self) -> int:
        return len(self.track_id)

    def retain(self, alive: BoolArray) -> None:
        """Delete the tracks outside the mask (N,)."""
        rows = alive.nonzero()[0]
        if len(rows) == len(self):
            return
        self.track_id, self.filters = self.track_id[rows], self.filters.select(rows)
        self.history, self.class_votes = (
            self.history.select(rows),
            self.class_votes.take(rows, axis=0),
        )
        self.class_id, self.score_sum, self.score = (
            self.class_id[rows],
            self.score_sum[rows],
            self.score[rows],
        )
        self.n_hits, self.is_confirmed = self.n_hits[rows], self.is_confirmed[rows]
        self.innovation, self.gallery = (
            self.innovation.take(rows, axis=0),
            self.gallery.select(rows),
        )

    def update(
        self,
        rows: IntArray,
        detections: Detections,
        matched: IntArray,
        time_s: float,
        *,
        is_streak: BoolArray,
        noise: MotionNoise,
    ) -> None:
        """Update M tracks, `rows`, with their detections of this frame, the rows `matched` (M,) of
        `detections`.

        `is_streak` (M,) is whether a track was also detected in the previous frame.
        """
        xyxy_px, score = detections.xyxy_px.take(matched, axis=0), detections.score[matched]
        is_person = self.class_id[rows] == _PERSON
        filters, innovation = motion.update(self.filters.select(rows), xyxy_px, noise, is_person)
        self.filters.assign(rows, filters)
        self.innovation[rows] = innovation[:, :2]
        self.history.append(rows, xyxy_px, time_s, is_streak=is_streak)
        self.class_votes[rows, detections.class_id[matched]] += score
        self._elect()
        self.score_sum[rows] += score
        self.score[rows] = score
        self.n_hits[rows] += 1
        if detections.descriptor.shape[1]:
            self.gallery = self.gallery.append(rows, detections.descriptor.take(matched, axis=0))

    def _elect(self) -> None:
        """Change the class of tracks for which another class leads by more votes than chance
        explains.
        """
        best = self.class_votes.argmax(axis=1)
        if (best == self.class_id).all():
            return
        row = np.arange(len(self))
        votes, own_votes = self.class_votes[row, best], self.class_votes[row, self.class_id]
        self.class_id = np.where(
            votes - own_votes > _MIN_LEAD * np.sqrt(votes + own_votes), best, self.class_id
        )

    def class_doubt(self, rows: IntArray) -> tuple[IntArray, FloatArray]:
        """(M,) class with the most other votes of the tracks `rows` (M,), and the probability that
        it leads in the end: votes scatter as `_elect` assumes. 0 for tracks of one class.
        """
        class_id, votes = self.class_id[rows], self.class_votes.take(rows, axis=0)
        if np.count_nonzero(votes) == len(rows):
            return class_id, np.zeros(len(rows))
        row = np.arange(len(rows))
        own_votes = votes[row, class_id]
        votes[row, class_id] = 0.0
        other = votes.argmax(axis=1)
        other_votes = votes[row, other]
        lead = (other_votes - own_votes) / np.sqrt(own_votes + other_votes)
        probability = np.where(other_votes > 0, ndtr(lead), 0.0)
        is_doubtful = probability > _LEAST_PROBABILITY
        return np.where(is_doubtful, other, class_id), np.where(is_doubtful, probability, 0.0)

    def initiate(
        self, first_id: int, detections: Detections, time_s: float, *, noise: MotionNoise
    ) -> None:
        """Add a tentative track for each detection; ids count from `first_id`."""
        n = len(detections)
        votes = np.zeros((n, len(ROAD_CLASSES)))
        votes[np.arange(n), detections.class_id] = np.maximum(detections.score, _LEAST_VOTE)
        new_history = history.initiate(
            detections.xyxy_px, time_s, n_kept=self.history.boxes.shape[1]
        )
        self.track_id = np.concatenate(
            [self.track_id, np.arange(first_id, first_id + n, dtype=np.int64)]
        )
        self.filters = self.filters.concatenate(motion.initiate(detections.xyxy_px, noise))
        self.history = self.history.concatenate(new_history)
        self.class_votes = np.concatenate([self.class_votes, votes])
        self.class_id = np.concatenate([self.class_id, detections.class_id])
        self.score_sum = np.concatenate([self.score_sum, detections.score])
        self.score = np.concatenate([self.score, detections.score])
        self.n_hits = np.concatenate([self.n_hits, np.ones(n, np.int64)])
        self.is_confirmed = np.concatenate([self.is_confirmed, np.zeros(n, np.bool_)])
        self.innovation = np.concatenate([self.innovation, np.full((n, 2), np.nan)])
        self.gallery = self.gallery.initiate(detections.descriptor)

    def compensate_camera_motion(self, now_from_before: FloatArray) -> None:
        """Transform filters and past boxes into pixels of the current frame, by a similarity (2,
        3).
        """
        self.filters = motion.compensate_camera_motion(self.filters, now_from_before)
        boxes_px = self.history.xyxy_px
        boxes_px[...] = motion.transformed(boxes_px, now_from_before)

    def shift(self, shift_px: FloatArray) -> None:
        """Move filters and past boxes by (2,) pixels."""
        self.filters.state[0, :, :2] += shift_px
        self.history.xyxy_px[...] += np.tile(shift_px, 2)
