"""DeepSortTracker: detections to tracks by motion, appearance and overlap.

    1. predict           the motion filters predict all tracks, compensated for camera motion; dead tracks are deleted
    2. associate         high-confidence detections - confirmed tracks   appearance within the motion gate, then IoU
                         low-confidence detections - confirmed tracks    IoU
                         high-confidence detections - tentative tracks   IoU of widened boxes; at low frame rates
                                                                         distance and size before
                         people - two-wheelers                           IoU: one rider, renamed
    3. update matched    tracks get their detections; tentative ones are confirmed
    4. initiate          unmatched high-confidence detections become tentative tracks
    5. output            confirmed tracks, with detected (or smoothed) boxes, or predicted ones for a short time

After SORT (Bewley et al., 2016), DeepSORT (Wojke et al., 2017), ByteTrack (Zhang et al., 2022) and
C-BIoU (Yang et al., 2023). The track-activation threshold, which separates high from low
confidence, is estimated from the persistence of detections (`confidence_threshold`), the
process-noise scale from the innovations (`motion`), so that one set of parameters suits
well-calibrated and over-confident detectors, static and driving cameras. The output is the detected
box instead of the filter's estimate, because distances are measured on it, whose filters expect
independent errors; the command `track` smooths it. The chi-square gate applies to appearance only:
boxes cut off by the image border or by an occluder do not follow the motion model, and IoU is a
gate by itself.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.detections import Detections
from track_range.foundation.arrays import BoolArray, FloatArray, Image, IntArray
from track_range.foundation.sparse_flow import BackgroundFlow
from track_range.tracking import history, motion
from track_range.tracking.appearance.embeddings import ColourLayout, ColourLayoutSettings
from track_range.tracking.appearance.gallery import unit_rows
from track_range.tracking.association import (
    Assignment,
    Classes,
    are_compatible,
    distance_cost,
    iou_cost,
    may_be_riders,
)
from track_range.tracking.camera_motion import CameraMotion
from track_range.tracking.common_motion import CommonMotion
from track_range.tracking.confidence_threshold import (
    ConfidenceThreshold,
    ConfidenceThresholdSettings,
)
from track_range.tracking.history import PredictionGates
from track_range.tracking.motion import MotionNoise, ProcessNoiseScale, ProcessNoiseSettings
from track_range.tracking.registry import AppearanceModel, TrackerOptions
from track_range.tracking.track_table import TrackTable
from track_range.tracking.tracks import Tracks

_OUTWARDS = np.array([-1.0, -1.0, 1.0, 1.0])  # directions of the left, top, right and bottom edge
_MAX_COSINE_DISTANCE_OF_FILES = 0.2  # deep_sort's, for its 128-dimensional embeddings


@dataclass(frozen=True, slots=True, kw_only=True)
class AppearanceSettings:
    """Gates of appearance: which detections may match a track by their embedding."""

    # from the nearest embedding; 0 = off; None = the model's, 0.2 of files
    max_cosine_distance: float | None = None
    # largest squared Mahalanobis distance: 99.7 % at 4 degrees of freedom
    gating_threshold: float = 16.0
    # fraction inside a nearer detection above which no embedding is computed
    max_occlusion: float = 0.5
    nn_budget: int = 4  # embeddings per track, including the running mean


@dataclass(frozen=True, slots=True, kw_only=True)
class DeepSortSettings:
    """Parameters of `DeepSortTracker`; scores and IoUs are in [0, 1], times in seconds.

    One set of defaults for all scenes, chosen on KITTI's cars and pedestrians (RRC boxes of 13
    sequences), 6 sequences of MOT15 and MOT17-05.
    """

    min_score: float = 0.1  # detections with a lower score are ignored
    # settings of the estimated score above which a detection has high confidence and can start a
    # track
    track_activation_threshold: ConfidenceThresholdSettings = field(
        default_factory=ConfidenceThresholdSettings
    )
    # minimum IoU of a high-confidence detection and the predicted box of a confirmed track
    min_iou: float = 0.2
    min_iou_low_confidence: float = 0.5  # the same of a low-confidence detection; stricter
    # minimum IoU of a high-confidence detection and a tentative track, both widened
    min_iou_tentative: float = 0.3
    # widening / box size, because the speed of a new track is unknown
    tentative_margin: float = 0.3
    # minimum IoU of a rider's boxes, one named person and the other one bicycle or motorcycle
    min_iou_rider: float = 0.5
    # time between two frames from which tracks are matched by distance and size
    min_distance_step_s: float = 0.15
    # largest squared Mahalanobis distance there: 99 % at 3 degrees of freedom
    max_distance: float = 11.3
    n_init: int = 2  # detections, one per frame, that confirm a tentative track
    init_score_sum: float = 1.5  # minimum sum of their scores; not used with `n_init` = 1
    # longest time without any detection that counts as skipped frames, not misses
    max_skipped_s: float = 1.0
    # longest time without a detection before a track is deleted; in videos, the next limit mostly
    # comes first (values of 2 to 8 s change HOTA by 0.01)
    max_age_s: float = 4.0
    # largest standard deviation of a position, in heights of the box
    max_position_sigma: float = 2.0
    score_half_life_s: float = 0.2  # time in which the score of a predicted box halves
    # whether detected boxes in the output are drawn towards the motion filters
    is_smoothed: bool = False
    classes: Classes = "similar"  # which classes may be one object
    # whether predictions move with the background, where there are images, or with all boxes
    is_camera_motion_compensated: bool = True
    noise: MotionNoise = field(default_factory=MotionNoise)  # noise of the motion filters
    # how the scale of the process noise is estimated
    process_noise: ProcessNoiseSettings = field(default_factory=ProcessNoiseSettings)
    # gates of appearance
    appearance: AppearanceSettings = field(default_factory=AppearanceSettings)
    # when a missing box is predicted
    prediction: PredictionGates = field(default_factory=PredictionGates)


# Road users look alike, parked cars most of all: appearance decides only near the prediction, where
# 59 % of the right boxes are (4 degrees of freedom), and overlap beyond. docs/concepts/accuracy.md
# has the effect.
ROAD = DeepSortSettings(appearance=AppearanceSettings(gating_threshold=4.0))
ROAD_COLOURS = ColourLayoutSettings(max_cosine_distance=0.05)


class DeepSortTracker:
    """Tracks the objects of one stream of frames; ids count from 1, and the output is
    deterministic.

    Tracks that start in the first frame are confirmed at once; later ones are tentative, and not in
    the output, until `DeepSortSettings.n_init` and `init_score_sum` are reached. Boxes without area
    are ignored.
    """

    def __init__(
        self,
        settings: DeepSortSettings | None = None,
        *,
        appearance_model: AppearanceModel | None = None,
        flow: BackgroundFlow | None = None,
        camera_motion: CameraMotion | None = None,
    ) -> None:
        """Create a tracker without tracks.

        `appearance_model` computes embeddings where there are images and the detections have none;
        None = appearance is not used. `flow` tracks the background, also for the odometry of the
        stream; None = a separate one. `camera_motion` estimates the motion of the background from
        the images; None = from `flow`.
        """
        self._settings = settings = settings or DeepSortSettings()
        self._appearance_model = appearance_model
        motion = camera_motion or CameraMotion(flow=flow)
        self._camera_motion = motion if settings.is_camera_motion_compensated else None
        self._common_motion = CommonMotion()  # in place of the camera's where there are no images
        self._activation_threshold = ConfidenceThreshold(settings.track_activation_threshold)
        self._noise_scale = ProcessNoiseScale(settings.process_noise)
        self._max_overlap_cost = 1 - np.array([settings.min_iou_low_confidence, settings.min_iou])
        self._table = TrackTable(
            n_boxes=settings.prediction.n_kept, n_embeddings=settings.appearance.nn_budget
        )
        self._next_id = 1
        self._last_s = -np.inf
        # time between the last two frames, and between any two
        self._step_s = self._shortest_step_s = np.inf
        # the last frame with any detection, in which objects of all sizes were sought: skipped
        # frames are not misses
        self._last_detected_s = -np.inf
        # the boxes of that frame, and the tracks that they continue; 0 = none
        self._last_xyxy_px, self._last_ids = np.zeros((0, 4)), np.zeros(0, np.int64)
        # edges of the boxes in the output so far, outwards
        self._outermost_px = np.full(4, -np.inf)

    def update(self, detections: Detections, time_s: float, image: Image | None) -> Tracks:
        """The confirmed tracks at `time_s`, by id: detected tracks, and missing tracks with a
        reliable prediction.

        `image` is used for camera motion, embeddings and the image border; without it, the border
        is the extent of all boxes so far. Raises ValueError: `time_s` is not later than in the
        previous call.
        """
        if not self._last_s < time_s < np.inf:
            raise ValueError(
                f"time_s: expected more than {self._last_s} s, the time of the last "
                f"frame, got {time_s} s"
            )
        is_valid = are_valid_boxes(detections.xyxy_px) & (
            detections.score >= self._settings.min_score
        )
        if not is_valid.all():
            detections = detections.select(is_valid)
        self._predict(detections, time_s, image)
        if detections.is_complete:  # else boxes are missing that persist
            self._activation_threshold.update(detections, self._moved())
        is_high = detections.score >= self.track_activation_threshold(detections.class_id)
        detections, max_cosine_distance = self._with_embeddings(detections, is_high, image)

        tracks, matched = self._associate(detections, is_high, max_cosine_distance).pairs()
        self._update_matched(tracks, detections, matched, time_s)
        is_high[matched] = False
        self._initiate_tracks(detections, is_high.nonzero()[0], time_s)

        self._last_s = time_s
        if len(detections) and detections.is_complete:
            self._last_detected_s = time_s
            self._last_xyxy_px, self._last_ids = (
                detections.xyxy_px.copy(),
                np.zeros(len(detections), np.int64),
            )
            self._last_ids[matched] = self._table.track_id[tracks]
        return self._output(time_s, image, is_complete=detections.is_complete)

    @property
    def tentative(self) -> Tracks:
        """The tracks detected in the last frame that are not confirmed yet."""
        table = self._table
        is_detected = table.history.last_s == self._last_s
        rows = (is_detected & ~table.is_confirmed).nonzero()[0]
        return self._detected(rows, table.history.last_xyxy_px.take(rows, axis=0))

    def track_activation_threshold(self, class_id: IntArray) -> FloatArray:
        """(N,) minimum score at which a detection of a class (N,) starts a track, as estimated so
        far.
        """
        return self._activation_threshold.of(class_id)

    def _with_embeddings(
        self, detections: Detections, is_high: BoolArray, image: Image | None
    ) -> tuple[Detections, float]:
        """Detections, with embeddings if visible and of high confidence, and the largest cosine
        distance of a match.

        The embeddings come from the detector or the appearance model; the distance is 0 where there
        are none.
        """
        settings, model = self._settings.appearance, self._appearance_model
        is_given, visible, max_cosine_distance = detections.descriptor.shape[1] > 0, None, 0.0
        if (
            settings.max_cosine_distance != 0
            and (is_given or not (image is None or model is None))
            and is_high.any()
        ):
            occlusion = history.occluded_fraction(detections.xyxy_px, detections.xyxy_px)
            is_visible = is_high & (occlusion <= settings.max_occlusion)
            if is_given:
                visible = unit_rows(detections.descriptor[is_visible])
                max_cosine_distance = _MAX_COSINE_DISTANCE_OF_FILES
            elif image is not None and model is not None:
                visible = model.embed(image, detections.xyxy_px[is_visible])
                max_cosine_distance = model.max_cosine_distance
        if visible is None:
            descriptor = np.zeros((len(detections), 0), np.float32)
            return replace(detections, descriptor=descriptor) if is_given else detections, 0.0
        embedding = np.zeros((len(detections), visible.shape[1]), np.float32)
        embedding[is_visible] = visible
        chosen_distance = settings.max_cosine_distance
        detections = replace(detections, descriptor=embedding)
        return detections, max_cosine_distance if chosen_distance is None else chosen_distance

    def _predict(self, detections: Detections, time_s: float, image: Image | None) -> None:
        """Stage 1: compensate camera motion, delete dead tracks, and predict the remaining tracks
        to `time_s`.
        """
        settings, table = self._settings, self._table
        if self._camera_motion is not None and image is not None:
            table.compensate_camera_motion(
                self._camera_motion.update(image, detections.xyxy_px, time_s)
            )
        is_alive = time_s - table.history.last_s <= settings.max_age_s
        is_streak = self._is_streak(time_s)
        is_alive &= (table.filters.position_sigma <= settings.max_position_sigma) | is_streak
        is_alive &= table.is_confirmed | is_streak
        table.retain(is_alive)
        self._step_s = dt_s = time_s - self._last_s
        self._shortest_step_s = min(self._shortest_step_s, dt_s)
        if len(table):
            table.filters = motion.predict(
                table.filters, dt_s, settings.noise, noise_scale=self._noise_scale.value
            )
        if self._camera_motion is not None and image is None:
            self._follow_common_motion(detections, time_s)

    def _follow_common_motion(self, detections: Detections, time_s: float) -> None:
        """Move all tracks by the shift that the boxes have in common, which is the camera's.

        At low frame rates, boxes move too far to find their tracks before the association.
        """
        settings, table = self._settings, self._table
        if self._step_s >= settings.min_distance_step_s or not self._common_motion.is_due():
            return
        rows = (table.history.last_s >= self._last_detected_s).nonzero()[0]
        shift_px = self._common_motion.update(
            table.filters.select(rows), table.class_id[rows], detections, time_s, settings.noise
        )
        if shift_px.any():
            table.shift(shift_px)

    def _moved(self) -> FloatArray:
        """(M, 4) boxes of the last frame with boxes; tracked boxes that move by over 0.35 of their
        size are predicted.

        Without the prediction, even an exact box would have an IoU of at most 1/2 with itself in
        this frame.
        """
        boxes_px, ids = self._last_xyxy_px, self._table.track_id
        if not len(ids):
            return boxes_px
        row = np.minimum(ids.searchsorted(self._last_ids), len(ids) - 1)
        boxes = (ids[row] == self._last_ids).nonzero()[0]
        filters, before = self._table.filters, motion.cxcywh(boxes_px.take(boxes, axis=0))
        moved_px = np.abs(filters.x.take(row[boxes], axis=0) - before)[:, :2]
        is_far = np.logical_or.reduce(moved_px > 0.35 * before[:, 2:], axis=1)
        if is_far.any():
            boxes_px[boxes[is_far]] = filters.xyxy_px[row[boxes[is_far]]]
        return boxes_px

    def _is_streak(self, time_s: float) -> BoolArray:
        """(N,) whether a track was detected since the last complete frame with any detection, at
        most `max_skipped_s` ago.

        At low frame rates, the limit is one and a half times the shortest step between two frames.
        """
        if time_s - self._last_detected_s > max(
            self._settings.max_skipped_s, 1.5 * self._shortest_step_s
        ):
            return np.zeros(len(self._table), np.bool_)
        return np.asarray(self._table.history.last_s >= self._last_detected_s)

    def _associate(
        self, detections: Detections, is_high: BoolArray, max_cosine_distance: float
    ) -> Assignment:
        """Stage 2: match detections and tracks; `max_cosine_distance` = 0: there are no
        embeddings.
        """
        settings, table = self._settings, self._table
        assignment = Assignment(len(table), len(detections))
        if not len(table) or not len(detections):
            return assignment
        confirmed, boxes_px = table.is_confirmed, table.filters.xyxy_px
        allowed = are_compatible(
            table.class_id, table.class_votes, detections.class_id, settings.classes
        )
        overlap_cost = iou_cost(boxes_px, detections.xyxy_px)
        overlap_cost[~allowed] = np.inf

        # First association: confirmed tracks and high-confidence detections, by appearance, then by
        # IoU.
        if max_cosine_distance > 0:
            gating_distance = motion.gating_distance(
                table.filters, detections.xyxy_px, settings.noise
            )
            is_gated_in = gating_distance <= settings.appearance.gating_threshold
            distance = table.gallery.cosine_distance(detections.descriptor, allowed & is_gated_in)
            is_recent = table.history.last_s >= self._last_detected_s
            # matching cascade: the most recently detected tracks first
            for is_in_level in (is_recent, ~is_recent):
                assignment.match(
                    distance, confirmed & is_in_level, is_high, max_cost=max_cosine_distance
                )
        else:
            assignment.match_unambiguous(
                overlap_cost, confirmed, self._max_overlap_cost.take(is_high)
            )
        assignment.match(overlap_cost, confirmed, is_high, max_cost=1 - settings.min_iou)

        # Second association: the remaining confirmed tracks and low-confidence detections.
        assignment.match(
            overlap_cost, confirmed, ~is_high, max_cost=1 - settings.min_iou_low_confidence
        )

        # At low frame rates, all tracks of the last frame and the remaining high-confidence
        # detections, by distance and size; then tentative tracks, both widened.
        if assignment.is_complete:
            return assignment
        if self._step_s >= settings.min_distance_step_s:
            is_last = table.history.last_s >= self._last_detected_s
            cost = distance_cost(table.filters, detections.xyxy_px, self._step_s, settings.noise)
            cost[~allowed] = np.inf
            assignment.match(cost, is_last, is_high, max_cost=settings.max_distance)
        i, j = assignment.unmatched(~confirmed, is_high)
        if len(i) and len(j):
            cost = iou_cost(boxes_px[i], detections.xyxy_px[j], margin=settings.tentative_margin)
            cost[~allowed[i[:, None], j]] = np.inf
            assignment.match_subset(cost, i, j, max_cost=1 - settings.min_iou_tentative)
        if settings.classes == "similar":
            self._match_riders(assignment, detections, boxes_px)
        return assignment

    def _match_riders(
        self, assignment: Assignment, detections: Detections, boxes_px: FloatArray
    ) -> None:
        """Match the remaining tracks and detections of riders, whom detectors name after the person
        or after what they ride; `boxes_px` (N, 4) are predicted.
        """
        confirmed, any_box = self._table.is_confirmed, np.ones(len(detections), np.bool_)
        for tracks in (confirmed, ~confirmed):
            i, j = assignment.unmatched(tracks, any_box)
            is_rider = may_be_riders(self._table.class_id[i], detections.class_id[j])
            if is_rider.any():
                cost = iou_cost(boxes_px[i], detections.xyxy_px[j])
                cost[~is_rider] = np.inf
                assignment.match_subset(cost, i, j, max_cost=1 - self._settings.min_iou_rider)

    def _update_matched(
        self, rows: IntArray, detections: Detections, matched: IntArray, time_s: float
    ) -> None:
        """Stage 3: update the matched tracks, confirm tentative ones, and update the process-noise
        scale.

        `rows` and `matched` (M,) are row numbers of the tracks and of their detections.
        """
        settings, table = self._settings, self._table
        if not len(rows):
            return
        innovation_before, is_streak = (
            table.innovation.take(rows, axis=0),
            self._is_streak(time_s)[rows],
        )
        table.update(rows, detections, matched, time_s, is_streak=is_streak, noise=settings.noise)
        table.is_confirmed |= (table.n_hits >= settings.n_init) & (
            table.score_sum >= settings.init_score_sum
        )
        # two detections give the first innovation
        min_hits = max(settings.process_noise.min_hits, 2)
        settled = (
            is_streak & (table.n_hits[rows] > min_hits) & table.is_confirmed[rows]
        ).nonzero()[0]
        self._noise_scale.update(
            innovation_before.take(settled, axis=0), table.innovation.take(rows[settled], axis=0)
        )

    def _initiate_tracks(self, detections: Detections, rows: IntArray, time_s: float) -> None:
        """Stage 4: start a tentative track for each unmatched high-confidence detection, in the
        rows (M,).
        """
        if not len(rows):
            return
        table, unmatched = self._table, detections.select(rows)
        table.initiate(self._next_id, unmatched, time_s, noise=self._settings.noise)
        self._next_id += len(unmatched)
        if self._last_s == -np.inf or self._settings.n_init <= 1:
            table.is_confirmed[-len(unmatched) :] = True

    def _output(self, time_s: float, image: Image | None, *, is_complete: bool) -> Tracks:
        """Stage 5: confirmed tracks by id, with the detected box, or a reliable predicted box."""
        settings, table = self._settings, self._table
        gates = settings.prediction
        if not is_complete:  # which explains a missing box as well as an occlusion does
            gates = replace(gates, min_hit_streak_visible=gates.min_hit_streak)
        is_detected = table.history.last_s == time_s
        rows = (table.is_confirmed & is_detected).nonzero()[0]
        boxes_px = table.history.last_xyxy_px.take(rows, axis=0)
        if image is None and len(rows):
            outermost_px = (boxes_px * _OUTWARDS).max(axis=0)
            np.maximum(self._outermost_px, outermost_px, out=self._outermost_px)
        detected = self._detected(rows, boxes_px)
        missing = (table.is_confirmed & ~is_detected).nonzero()[0]
        if not len(missing) or gates.max_missing_s <= 0:
            return detected
        border_px = self._outermost_px * _OUTWARDS
        if image is not None:
            border_px = np.array([-0.5, -0.5, image.shape[1] - 0.5, image.shape[0] - 0.5])
        predicted, predicted_px = history.predict_missing(
            table.history.select(missing),
            time_s,
            gates=gates,
            border_xyxy_px=border_px,
            others_xyxy_px=boxes_px,
        )
        if not len(predicted):
            return detected
        missing = missing[predicted]
        missing_s = time_s - table.history.last_s[missing]
        score = table.score[missing] * 0.5 ** (missing_s / settings.score_half_life_s)
        shown = np.concatenate([rows, missing])
        order = shown.argsort()
        shown = shown[order]
        return Tracks(
            table.track_id[shown],
            np.concatenate([detected.xyxy_px, predicted_px]).take(order, axis=0),
            table.class_id[shown],
            np.concatenate([detected.score, score])[order],
            order < len(rows),
            *table.class_doubt(shown),
        )

    def _detected(self, rows: IntArray, xyxy_px: FloatArray) -> Tracks:
        """The tracks in `rows` with their detected boxes (M, 4), smoothed if the settings ask for
        it.
        """
        table = self._table
        if self._settings.is_smoothed and len(rows):
            xyxy_px = motion.smoothed(table.filters.x.take(rows, axis=0), xyxy_px)
        return Tracks(
            table.track_id[rows],
            xyxy_px,
            table.class_id[rows],
            table.score[rows],
            np.ones(len(rows), np.bool_),
            *table.class_doubt(rows),
        )


def road(options: TrackerOptions) -> DeepSortTracker:
    """`--tracker road`: deepsort with the settings of `ROAD`, and stricter colours."""
    settings = replace(ROAD, is_smoothed=options.is_smoothed)
    model = options.reid or ColourLayout(ROAD_COLOURS)
    return DeepSortTracker(settings, appearance_model=model, flow=options.flow)


def deepsort(options: TrackerOptions) -> DeepSortTracker:
    """`--tracker deepsort`: appearance from the user's re-identification network, or from colour
    histograms.
    """
    settings = DeepSortSettings(is_smoothed=options.is_smoothed)
    return DeepSortTracker(
        settings, appearance_model=options.reid or ColourLayout(), flow=options.flow
    )


def sort(options: TrackerOptions) -> DeepSortTracker:
    """`--tracker sort`: the same tracker without appearance."""
    appearance = AppearanceSettings(max_cosine_distance=0.0)
    return DeepSortTracker(
        DeepSortSettings(is_smoothed=options.is_smoothed, appearance=appearance), flow=options.flow
    )
