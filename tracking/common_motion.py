"""Common motion: the image shift that the boxes of a frame have in common, where there are no
images.

A camera that turns or pitches moves all boxes alike, so that the innovations of different tracks
agree, which they do not if the camera stands. With y_i the innovation of the centre of track i, S_i
its variance, and m the shift, per axis:

    y_i = m + e_i         m ~ N(0, C),  e_i ~ N(0, S_i), independent
    C   = E[y_i y_j], i != j        weighted mean over pairs of tracks, then over the last second
    m   = C / (C + V) sum w_i y_i / sum w_i         V = 1 / sum w_i,  w_i = 1 / S_i / (1 + (y_i - m)^2 / 4 S_i)

C is the evidence for a camera that moves. Where it is small, nothing is moved, and only every third
frame is looked at. The weights are those of Cauchy's distribution: some pairs are wrong.
"""

import math

import numpy as np

from track_range.detection.classes import SAME_OBJECT_GROUP
from track_range.detection.detections import Detections
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.tracking.motion import BoxFilters, MotionNoise, cxcywh

_MEMORY_S = 1.0  # time constant of C: turns of a camera begin and end within about a second
_MAX_DISTANCE = 4.0  # largest distance of a pair, in standard deviations
_MAX_LOG_HEIGHT = 0.3  # largest difference of the heights of a pair, as a logarithm
_MAX_TRACKS = 32  # tracks that are used; of more tracks, every k-th
_SAMPLING_STEP = 3  # of the frames of a camera that stands
_N_ROUNDS = 2  # of reweighting
_MIN_EVIDENCE = 0.4  # C / V from which the camera moves: of a camera that stands, C has noise of V


class CommonMotion:
    """The common shift of the boxes of one stream."""

    def __init__(self) -> None:
        self._variance: FloatArray = np.zeros(2)  # C, px^2
        self._last_s = -math.inf  # time of the last frame that was looked at
        self._n_frames = 0
        self._is_moving = False

    def is_due(self) -> bool:
        """Whether the next frame is looked at; to be called once in each frame."""
        self._n_frames += 1
        return self._is_moving or self._n_frames % _SAMPLING_STEP == 0

    def update(
        self,
        filters: BoxFilters,
        class_id: IntArray,
        detections: Detections,
        time_s: float,
        noise: MotionNoise,
    ) -> FloatArray:
        """(2,) shift in px of the boxes of this frame from the predictions of N tracks of the
        classes (N,) that the last frame showed.

        Zeros with fewer than two pairs of a track and a detection that are nearest to each other.
        """
        step = -(-len(filters) // _MAX_TRACKS)
        if step > 1:
            filters, class_id = filters.select(np.arange(0, len(class_id), step)), class_id[::step]
        self._is_moving = False
        if len(filters) < 2 or len(detections) < 2:
            return np.zeros(2)
        x, z = filters.x, cxcywh(detections.xyxy_px)
        distance_px = np.abs((z[:, 0] + 1j * z[:, 1]) - (x[:, :1] + 1j * x[:, 1:2]))
        nearest = distance_px.argmin(axis=1)
        row = np.arange(len(nearest))
        z, S = z.take(nearest, axis=0), filters.P[0] + (noise.measured * filters.height_px) ** 2
        is_pair = distance_px.argmin(axis=0)[nearest] == row
        is_pair &= distance_px[row, nearest] <= _MAX_DISTANCE * np.sqrt(S)
        is_pair &= np.abs(np.log(z[:, 3] / filters.height_px)) <= _MAX_LOG_HEIGHT
        is_pair &= SAME_OBJECT_GROUP[class_id] == SAME_OBJECT_GROUP[detections.class_id[nearest]]
        i = is_pair.nonzero()[0]
        if len(i) < 2:
            return np.zeros(2)
        memory = math.exp(-(time_s - self._last_s) / _MEMORY_S)
        self._last_s = time_s
        return self._shift((z[:, :2] - x[:, :2]).take(i, axis=0), S[i], memory=memory)

    def _shift(self, y: FloatArray, S: FloatArray, *, memory: float) -> FloatArray:
        """(2,) m of innovations (K, 2) with variances (K,); `memory` is the weight of C so far."""
        w = (1 / S)[:, None]
        wy, total = w * y, float(w.sum())
        sum_wy = wy.sum(axis=0)
        product = (sum_wy**2 - np.vecdot(wy.T, wy.T)) / (total**2 - float(np.vecdot(w.T, w.T)[0]))
        self._variance = memory * self._variance + (1 - memory) * product
        C = np.maximum(self._variance, 0.0)
        least = _MIN_EVIDENCE / total
        self._is_moving = bool((least < C).any())
        if not self._is_moving:
            return np.zeros(2)
        m = sum_wy / total
        for _ in range(_N_ROUNDS):
            robust = w / (1 + (y - m) ** 2 * (w / 4))
            robust_sum = robust.sum(axis=0)
            m = (robust * y).sum(axis=0) / robust_sum
        return np.asarray(m * (C / (C + 1 / robust_sum)))
