"""DeepSortTracker: boxes to identities by motion, overlap and looks; weak boxes keep a track but do not start one.

    strong boxes --> 1. looks: tracks seen last, then lost ones    (where there are descriptors)
                 --> 2. overlap: confirmed and lost tracks
    weak boxes   --> 3. overlap: what is left of them
    strong boxes --> 4. overlap, widened: tentative tracks --> 5. new tentative tracks

After SORT (Bewley et al., 2016), DeepSORT (Wojke et al., 2017), ByteTrack (Zhang et al., 2022) and C-BIoU (Yang et al.,
2023). What is strong is learnt from the detector's own persistence (`score_threshold`), how restless motion is from the
filters' innovations (`noise_level`), so that one setting serves calibrated and boastful detectors, standing and driving
cameras. What is reported is the box that was detected, not the filter's opinion of it, whose edges lag; missing boxes
are `tracking.history`'s. The chi-square gate stands before looks only: boxes cut by the image border or by an occluder
break the filter's model, and overlap is its own gate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from track_range.detection.boxes import are_sound
from track_range.detection.detections import Detections
from track_range.foundation.arrays import BoolArray, FloatArray, Image, IntArray
from track_range.tracking import history, motion
from track_range.tracking.appearance import ColourLayout
from track_range.tracking.association import are_compatible, assigned, iou_cost
from track_range.tracking.camera_motion import CameraMotion
from track_range.tracking.confidence_threshold import ScoreThreshold
from track_range.tracking.gallery import Gallery, unit_rows
from track_range.tracking.process_noise import NoiseLevel
from track_range.tracking.track_table import TrackTable
from track_range.tracking.tracker import AppearanceModel, TrackerOptions
from track_range.tracking.tracker_settings import AppearanceGates, TrackerSettings
from track_range.tracking.tracks import Tracks

_MAX_DISTANCE_OF_FILES = 0.2
"""Cosine distance up to which descriptors of a file are one object's: deep_sort's, for its vectors of 128 numbers."""

_UNRELATED_COST = 0.95
"""1 - IoU from which on a track and a box have nothing to do with each other."""


class DeepSortTracker:
    """Tracks one stream of frames; ids count from 1 and the same input gives the same output.

    Tracks are confirmed at once in the first frame; later they are tentative, and not reported, until
    `TrackerSettings.confirm_hits` and `confirm_score` are reached. Boxes that are not finite, or have no area or score,
    are ignored.
    """

    def __init__(
        self, settings: TrackerSettings | None = None, *, appearance_model: AppearanceModel | None = None
    ) -> None:
        """A tracker that has seen nothing.

        Args:
            settings: thresholds.
            appearance_model: computes embeddings of boxes, where there are images and detections bring no embeddings;
                None = nothing does.
        """
        self._settings = keep = settings or TrackerSettings()
        self._appearance_model = appearance_model
        self._camera = CameraMotion() if keep.is_camera_followed else None
        self._strong, self._level = ScoreThreshold(keep.strong_score), NoiseLevel(keep.level)
        self._table = TrackTable(n_kept=keep.fill.n_kept, gallery=Gallery.empty(n_kept=keep.appearance.n_kept))
        self._next_id, self._last_s = 1, -np.inf
        self._last_fed_s = -np.inf  # of the last frame with any box: who detects in every second frame misses nothing
        self._extent_px: FloatArray | None = None

    def update(self, detections: Detections, time_s: float, image: Image | None) -> Tracks:
        """The confirmed tracks at `time_s`, by id: seen ones, and lost ones whose box could be predicted.

        `image` tells the camera's motion, what boxes look like, and the border; without it the border is taken from the
        extent of all boxes so far.

        Raises:
            ValueError: time does not go forward.
        """
        if not self._last_s < time_s < np.inf:
            raise ValueError(f"time must go forward: {time_s} s after {self._last_s} s")
        found = self._worth_looking_at(detections)
        self._strong.learn(found)
        strong = found.score >= self._strong.of(found.class_id)
        found, max_distance = self._described(found, strong, image)
        self._move_to(time_s, found, image)
        rows, columns = self._pairs(found, strong, max_distance)
        self._see(rows, found.select(columns), time_s)
        strong[columns] = False
        if strong.any():
            self._begin(found.select(strong), time_s)
        self._last_s = time_s
        if len(found):
            self._last_fed_s = time_s
        return self._reported(time_s, image)

    @property
    def tentative(self) -> Tracks:
        """The tracks seen in the last frame that are not confirmed yet; some will be, others never."""
        table = self._table
        return self._as_tracks(np.flatnonzero((table.last_s == self._last_s) & ~table.is_confirmed))

    def track_activation_threshold(self, class_id: IntArray) -> FloatArray:
        """(N,) from which score on boxes of these classes are taken to be objects, as learnt so far."""
        return self._strong.of(class_id)

    def _worth_looking_at(self, detections: Detections) -> Detections:
        good = are_sound(detections.xyxy_px) & (detections.score >= self._settings.low_score)
        return detections if good.all() else detections.select(good)

    def _described(self, found: Detections, strong: BoolArray, image: Image | None) -> tuple[Detections, float]:
        """With descriptors of the strong boxes, the detector's own or those of who describes, and their gate.

        What a nearer box hides has no looks of its own: it would make the one behind look like the one in front.
        """
        told = self._settings.appearance.max_distance
        nobody = Detections.of(found.xyxy_px, found.score, found.class_id), 0.0
        if told == 0 or not strong.any():
            return nobody
        if found.descriptor.shape[1]:
            clear, limit = self._are_clear(found, strong), _MAX_DISTANCE_OF_FILES
            of_clear = unit_rows(found.descriptor[clear])
        elif image is not None and self._appearance_model is not None:
            clear, limit = self._are_clear(found, strong), self._appearance_model.max_distance
            of_clear = self._appearance_model.embed(image, found.xyxy_px[clear])
        else:
            return nobody
        descriptor = np.zeros((len(found), of_clear.shape[1]), np.float32)
        descriptor[clear] = of_clear
        return replace(found, descriptor=descriptor), limit if told is None else told

    def _are_clear(self, found: Detections, strong: BoolArray) -> BoolArray:
        hidden = history.hidden_share(found.xyxy_px, found.xyxy_px)
        return np.asarray(strong & (hidden <= self._settings.appearance.max_hidden))

    def _move_to(self, time_s: float, found: Detections, image: Image | None) -> None:
        """Predict the tracks that are still alive."""
        keep, table = self._settings, self._table
        if self._camera is not None and image is not None:
            table.carry(self._camera.update(image, found.xyxy_px))
        recent = (time_s - table.last_s <= keep.max_lost_s) & (table.filters.spread <= keep.max_spread)
        table.keep(recent & (table.is_confirmed | self._are_running(time_s)))
        if len(table):
            dt_s = time_s - self._last_s
            table.filters = motion.predicted(table.filters, dt_s, keep.noise, level=self._level.value)

    def _are_running(self, time_s: float) -> BoolArray:
        """(N,) which tracks were seen in the frame before, as far as it had any boxes, and not too long ago."""
        last_s = self._table.last_s
        return np.asarray((last_s == self._last_fed_s) & (time_s - last_s <= self._settings.max_break_s))

    def _pairs(self, found: Detections, strong: BoolArray, max_distance: float) -> tuple[IntArray, IntArray]:
        """Rows of tracks and of boxes that belong together, stage by stage, each with what the ones before left."""
        keep, table = self._settings, self._table
        pairing = _Pairing(len(table), len(found))
        if not len(table) or not len(found):
            return pairing.rows, pairing.columns
        boxes, confirmed = table.filters.xyxy_px, table.is_confirmed
        may = are_compatible(table.label, found.class_id, keep.classes)
        cost = iou_cost(boxes, found.xyxy_px)
        cost[~may] = np.inf
        if max_distance > 0:
            looks = self._cost_of_looks(found, may)
            fresh = table.last_s == self._last_fed_s
            for tracks in (fresh, ~fresh):  # the cascade: who was seen last chooses first
                pairing.add(looks, confirmed & tracks, strong, max_cost=max_distance)
        else:
            max_cost = np.where(strong, 1 - keep.min_iou, 1 - keep.weak_min_iou)
            pairing.add_unrivalled(cost, confirmed, max_cost)
        pairing.add(_part_of(cost), confirmed, strong, max_cost=1 - keep.min_iou)
        pairing.add(_part_of(cost), confirmed, ~strong, max_cost=1 - keep.weak_min_iou)

        def widened(i: IntArray, j: IntArray) -> FloatArray:
            wide = iou_cost(boxes[i], found.xyxy_px[j], margin=keep.tentative_margin)
            return np.where(may[np.ix_(i, j)], wide, np.inf)

        pairing.add(widened, ~confirmed, strong, max_cost=1 - keep.tentative_min_iou)
        return pairing.rows, pairing.columns

    def _cost_of_looks(self, found: Detections, may: BoolArray) -> Callable[[IntArray, IntArray], FloatArray]:
        """Cosine distances, inf beyond the chi-square gate."""
        gates, table = self._settings.appearance, self._table
        squared = motion.squared_mahalanobis(table.filters, found.xyxy_px, self._settings.noise)
        distance = table.gallery.cosine_distance(found.descriptor, may & (squared <= gates.max_mahalanobis))
        return _part_of(distance)

    def _see(self, rows: IntArray, found: Detections, time_s: float) -> None:
        """Give each of these tracks its box, and learn from how they moved."""
        keep, table = self._settings, self._table
        if not len(rows):
            return
        before, are_running = table.innovation[rows], self._are_running(time_s)[rows]
        table.see(rows, found, time_s, are_running=are_running, noise=keep.noise)
        if found.descriptor.shape[1]:
            table.gallery = table.gallery.appended(rows, found.descriptor)
        if not table.is_confirmed.all():
            table.is_confirmed |= (table.n_hits >= keep.confirm_hits) & (table.evidence >= keep.confirm_score)
        steady = are_running & (table.n_hits[rows] > keep.level.min_hits) & table.is_confirmed[rows]
        steady &= np.isfinite(before[:, 0])
        self._level.learn(before[steady], table.innovation[rows[steady]])

    def _begin(self, found: Detections, time_s: float) -> None:
        """New tracks of strong boxes that belong to nobody."""
        table = self._table
        table.begin(self._next_id, found, time_s, noise=self._settings.noise)
        table.gallery = table.gallery.begun(found.descriptor)
        self._next_id += len(found)
        if self._last_s == -np.inf or self._settings.confirm_hits <= 1:
            table.is_confirmed[-len(found) :] = True

    def _reported(self, time_s: float, image: Image | None) -> Tracks:
        """Confirmed tracks by id: boxes as detected, then what can be predicted of the missing."""
        table = self._table
        seen = table.last_s == time_s
        lost = np.flatnonzero(table.is_confirmed & ~seen)
        rows = np.flatnonzero(table.is_confirmed & seen)
        tracks = self._as_tracks(rows)
        border_px = self._border(tracks.xyxy_px, image)
        if not len(lost) or self._settings.fill.max_missing_s <= 0:
            return tracks
        filled, boxes = history.filled(
            table.past.select(lost),
            time_s,
            gates=self._settings.fill,
            border_xyxy_px=border_px,
            others_xyxy_px=tracks.xyxy_px,
        )
        if not len(filled):
            return tracks
        lost = lost[filled]
        faded = table.score[lost] * 0.5 ** ((time_s - table.last_s[lost]) / self._settings.score_half_life_s)
        everyone = Tracks(
            np.concatenate([tracks.track_id, table.track_id[lost]]),
            np.concatenate([tracks.xyxy_px, boxes]),
            np.concatenate([tracks.class_id, table.label[lost]]),
            np.concatenate([tracks.score, faded]),
            np.arange(len(tracks) + len(lost)) < len(tracks),
        )
        return everyone.select(np.argsort(everyone.track_id))

    def _as_tracks(self, rows: IntArray) -> Tracks:
        """Tracks seen in this frame, with the boxes that were detected."""
        table = self._table
        seen = np.ones(len(rows), np.bool_)
        return Tracks(table.track_id[rows], table.last_xyxy_px[rows], table.label[rows], table.score[rows], seen)

    def _border(self, xyxy_px: FloatArray, image: Image | None) -> FloatArray | None:
        """(4,) edges of the image; without one, the extent of the boxes reported so far."""
        if image is not None:
            return np.array([-0.5, -0.5, image.shape[1] - 0.5, image.shape[0] - 0.5])
        if len(xyxy_px):
            low, high = xyxy_px[:, :2].min(axis=0), xyxy_px[:, 2:].max(axis=0)
            if self._extent_px is not None:
                low, high = np.minimum(low, self._extent_px[:2]), np.maximum(high, self._extent_px[2:])
            self._extent_px = np.concatenate([low, high])
        return self._extent_px


class _Pairing:
    """Pairs of tracks and boxes, gathered in stages."""

    def __init__(self, n_tracks: int, n_boxes: int) -> None:
        self.rows, self.columns = np.zeros((2, 0), np.int64)
        self._free_track, self._free_box = np.ones(n_tracks, np.bool_), np.ones(n_boxes, np.bool_)

    def add_unrivalled(self, cost: FloatArray, tracks: BoolArray, max_cost: FloatArray) -> None:
        """Pair tracks and boxes (max_cost (M,) each) that overlap with each other and with hardly anything else.

        The stages after would pair them too, one by one: most of a frame is done with here.
        """
        related = cost <= _UNRELATED_COST
        column = related.argmax(axis=1)
        alone = tracks & (related.sum(axis=1) == 1) & (related.sum(axis=0) == 1)[column]
        rows = alone.nonzero()[0]
        good = cost[rows, column[rows]] <= max_cost[column[rows]]
        self._take(rows[good], column[rows[good]])

    def add(
        self,
        cost: Callable[[IntArray, IntArray], FloatArray],
        tracks: BoolArray,
        boxes: BoolArray,
        *,
        max_cost: float,
    ) -> None:
        """Pair what is free among these tracks and boxes; `cost` gives (N, M) for rows (N,) and columns (M,)."""
        i, j = (tracks & self._free_track).nonzero()[0], (boxes & self._free_box).nonzero()[0]
        if not len(i) or not len(j):
            return
        r, c = assigned(cost(i, j), max_cost=max_cost)
        self._take(i[r], j[c])

    def _take(self, rows: IntArray, columns: IntArray) -> None:
        self._free_track[rows], self._free_box[columns] = False, False
        self.rows, self.columns = np.concatenate([self.rows, rows]), np.concatenate([self.columns, columns])


def _part_of(cost: FloatArray) -> Callable[[IntArray, IntArray], FloatArray]:
    """What `_Pairing.add` asks for, from a matrix of all tracks and boxes."""
    return lambda i, j: cost[i[:, None], j]


def deepsort(options: TrackerOptions) -> DeepSortTracker:
    """`--tracker deepsort`: the defaults, with the user's re-identification network or colour histograms."""
    return DeepSortTracker(appearance_model=options.reid or ColourLayout())


def sort(_options: TrackerOptions) -> DeepSortTracker:
    """`--tracker sort`: the same without appearance."""
    return DeepSortTracker(TrackerSettings(appearance=AppearanceGates(max_distance=0.0)))
