"""PairEvidence: evidence from features of the first pairs about the relative position of left and
right images.

Features (ORB) are matched between left and right, also with the right image mirrored, and between
successive left images. The disparities d of the matches are compared with inverse depths r from the
motion of the left camera:

    r = beta (d - o)        beta > 0: as in the rig, with an error o of all disparities, such as a wrong vergence
                            beta < 0: left and right are exchanged

The error o is the one that most points of all steps agree with; points are in front of the camera,
so that r >= 0.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, Image, IntArray
from track_range.stereo.alignment.right_view import RightView, fit_right_view
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import grey

# of the right image relative to the left one
Arrangement = Literal["equal", "turned", "mirrored", "flipped"]
_MAX_WIDTH_PX = 1400  # wider images are reduced by a whole factor
_N_FEATURES = 700  # number of features in each half of an image, the upper and the lower one
# largest ratio of the distances of the best and the second best match (Lowe 2004)
_MAX_RATIO = 0.85
_MAX_ANGLE_DEG = 30.0  # largest difference of the orientations of matching features
_MIN_MATCHES = 30  # minimum number of matches
# Fractions of the matches, and of the features, in a band of rows from which no other arrangement
# is tried.
_MIN_FRACTION, _MIN_MATCHED = 0.3, 0.15
# largest differences of rows: of the band, of the fit, of inliers
_BAND_PX, _GATE_PX, _ROW_PX = 6.0, 12.0, 2.0
_MIN_FLOW_PX = 3.0  # minimum median motion between two left images
_MIN_PARALLAX_PX = 5.0  # minimum motion of a point as far away as the step is long
# smallest range of the disparities of a step: those of a wall do not show an offset
_MIN_RANGE_PX = 3.0
_EPIPOLAR_PX = 1.5  # largest distance of a tracked point from its epipolar line
_OFFSETS_PX = np.arange(-90.0, 91.0, 1.5)  # errors o that are tried
_SWAPPED_PX = 4.5  # largest error o of exchanged images: a second fault is unlikely
_N_SLOPES = 40  # number of points of a step whose beta is tried
_BEHIND_PX = 1.5  # largest d - o of the wrong sign, for noise
_POINT_PX = 2.0  # difference from the motion at which a point no longer agrees
# Agreeing fraction of the matches below which, and change of rows between pairs above which, times
# are compared: at true pairs 0.90 and 0.08 px, with a lag of one frame 0.77 and 0.15 px (KITTI,
# seven simulated drives).
_STEADY_FRACTION, _STEADY_PX = 0.85, 0.12
_REPEATED_PX = 0.3  # largest median motion of a repeated image
# pairs by which times are shifted, and number of left images that are compared
_MAX_SHIFT, _N_SHIFTED = 5, 3
_MIN_GAIN = 1.25  # ratio of the matches at another time to those of the pairs


class Features(NamedTuple):
    """Points of an image."""

    xy_px: FloatArray  # (N, 2)
    angle_deg: FloatArray  # (N,)
    descriptors: npt.NDArray[np.uint8]  # (N, 32)


class _Pair(NamedTuple):
    """Matches of a pair: points of the left image, and of the right image after its arrangement was
    undone.
    """

    arrangement: Arrangement
    n_matches: int  # of all orientations
    left_px: FloatArray  # (N, 2)
    right_px: FloatArray  # (N, 2)
    number: IntArray  # (N,) features of the left image

    def n_in_band(self, half_width_px: float = _BAND_PX) -> int:
        """Largest number of matches in a band of rows of the given half width."""
        return int(_in_band(self.right_px[:, 1] - self.left_px[:, 1], half_width_px).sum())


class _Step(NamedTuple):
    """Left features of a pair that were found in the next left image."""

    pair: int
    number: IntArray  # (N,) features of the left image
    inverse_depth: FloatArray  # (N,) times the length of the step
    parallax_px: FloatArray  # (N,) motion at inverse depth 1


class Motion(NamedTuple):
    """Agreement of disparities with the motion of the left camera."""

    n_points: int
    n_steps: int
    support: float  # fraction of the points that agree with the rig and the error `offset_px`, 0..1
    offset_px: float  # measured minus true disparity
    sigma_px: float  # standard deviation of the offset
    exchanged_support: float  # fraction of the points that agree with left and right exchanged


@dataclass(frozen=True, slots=True)
class PairFigures:
    """Summary of some pairs, in pixels of the full images."""

    n_pairs: int
    n_tracked: float  # median number of matches between successive left images; 0 with one pair
    n_matches: int  # number of matches between left and right in all pairs
    arrangement: Arrangement
    row_fraction: float  # fraction of the matches that agree with `view`, 0..1
    row_change_px: float  # standard deviation over the pairs of the row offset, in reduced images
    view: RightView  # rows of the right camera, with its yaw
    left_px: FloatArray  # (N, 2) agreeing points
    right_px: FloatArray  # (N, 2) agreeing points, corrected by `view` without its yaw
    motion: Motion | None  # None = the camera does not move enough
    turned_motion: Motion | None  # the same with the points corrected by the yaw
    # rank correlation of disparities with rows, -1..1, above and below the optical axis
    ground: tuple[float, float]
    is_late: bool  # whether one side repeats its images, or pairs at other times agree better

    @property
    def disparity_px(self) -> FloatArray:
        """(N,) disparities of the agreeing points."""
        return np.asarray(self.left_px[:, 0] - self.right_px[:, 0])


class PairEvidence:
    """Collects the evidence of rectified pairs of one rig."""

    def __init__(self, camera: PinholeCamera) -> None:
        self._factor = f = math.ceil(camera.width_px / _MAX_WIDTH_PX)
        cx_px, cy_px = (camera.cx_px + 0.5) / f - 0.5, (camera.cy_px + 0.5) / f - 0.5
        self._camera = PinholeCamera(
            camera.fx_px / f,
            camera.fy_px / f,
            cx_px,
            cy_px,
            camera.width_px // f,
            camera.height_px // f,
        )
        self._lefts: list[Features] = []
        self._rights: list[Features] = []  # as recorded
        self._pairs: list[_Pair] = []
        self._steps: list[_Step] = []
        self._n_tracked: list[int] = []
        self.flow_px = 0.0  # median motion between the last two left images

    @property
    def n_pairs(self) -> int:
        """Number of pairs so far."""
        return len(self._pairs)

    def add(self, left: Image, right: Image) -> None:
        """Add the next pair, rectified (H, W) or (H, W, 3) each."""
        size_px = (self._camera.width_px, self._camera.height_px)
        if self._factor > 1:
            left, right = (
                np.asarray(cv2.resize(grey(image), size_px, interpolation=cv2.INTER_AREA), np.uint8)
                for image in (left, right)
            )
        features = _features(left)
        if self._lefts:
            self._add_step(self._lefts[-1], features)
        self._lefts.append(features)
        self._rights.append(_features(right))
        pair = _pair(features, self._rights[-1], size_px)
        n_expected = max(
            _MIN_MATCHES, _MIN_FRACTION * pair.n_matches, _MIN_MATCHED * len(features.xy_px)
        )
        if pair.n_in_band() < n_expected:
            mirrored = _pair(
                features,
                _features(np.asarray(cv2.flip(right, 1), np.uint8)),
                size_px,
                is_mirrored=True,
            )
            pair = max(pair, mirrored, key=lambda one: one.n_in_band())
        self._pairs.append(pair)

    def _add_step(self, before: Features, now: Features) -> None:
        first, second = _matches(before, now)
        self._n_tracked.append(len(first))
        self.flow_px = 0.0
        if len(first) < _MIN_MATCHES:
            return
        from_px, to_px = before.xy_px[first], now.xy_px[second]
        self.flow_px = float(np.median(np.linalg.norm(to_px - from_px, axis=1)))
        if self.flow_px < _MIN_FLOW_PX:
            return
        matrix = self._camera.matrix
        essential, is_inlier = cv2.findEssentialMat(from_px, to_px, matrix, cv2.RANSAC, 0.999, 1.0)
        if essential is None or essential.shape != (3, 3):
            return
        _, rotation, translation, _ = cv2.recoverPose(
            essential, from_px, to_px, matrix, mask=is_inlier
        )
        ray = self._camera.rays(from_px) @ rotation.T
        to = self._camera.rays(to_px)[:, :2]
        t = translation.ravel()
        flow, unit = to * ray[:, 2:] - ray[:, :2], t[:2] - to * t[2]
        length = np.maximum(np.linalg.norm(unit, axis=1), 1e-9)
        across = np.abs(unit[:, 0] * flow[:, 1] - unit[:, 1] * flow[:, 0]) / length
        f = self._camera.fx_px
        is_used = (across * f < _EPIPOLAR_PX) & (length * f > _MIN_PARALLAX_PX)
        inverse_depth = (flow * unit).sum(axis=1) / length**2
        step = _Step(
            len(self._pairs) - 1, first[is_used], inverse_depth[is_used], length[is_used] * f
        )
        self._steps.append(step)

    def figures(self) -> PairFigures:
        """The summary of the pairs so far."""
        kinds = [pair.arrangement for pair in self._pairs for _ in range(pair.n_in_band())] or [
            "equal"
        ]
        arrangement: Arrangement = max(set(kinds), key=kinds.count)
        used = [(i, pair) for i, pair in enumerate(self._pairs) if pair.arrangement == arrangement]
        index = np.concatenate([np.full(len(pair.number), i) for i, pair in used])
        left_px, right_px, number = (
            np.concatenate(part) for part in zip(*(pair[2:] for _, pair in used), strict=True)
        )
        view, is_agreeing, corrected_px = self._rows(left_px, right_px)
        turned_px = view.corrected(right_px, self._camera)
        residual_px = np.where(is_agreeing, turned_px[:, 1] - left_px[:, 1], np.nan)
        offsets = [np.nanmean(residual_px[index == i]) for i in np.unique(index[is_agreeing])]
        rows = index[is_agreeing], number[is_agreeing]
        motion, turned_motion = (
            self._motion(*rows, (left_px - px)[is_agreeing, 0]) for px in (corrected_px, turned_px)
        )
        n_matches = sum(pair.n_matches for pair in self._pairs)
        row_fraction = float(is_agreeing.sum()) / max(n_matches, 1)
        change_px = float(np.std(offsets)) if offsets else 0.0
        is_clean = (
            view == RightView() and row_fraction >= _STEADY_FRACTION and change_px <= _STEADY_PX
        )
        points = np.column_stack([(left_px - turned_px)[:, 0], left_px[:, 1]])[is_agreeing]
        is_low = points[:, 1] > self._camera.cy_px
        f = self._factor
        return PairFigures(
            n_pairs=self.n_pairs,
            n_tracked=float(np.median(self._n_tracked)) if self._n_tracked else 0.0,
            n_matches=n_matches,
            arrangement=arrangement,
            row_fraction=row_fraction,
            row_change_px=change_px,
            view=replace(view, row_offset_px=f * view.row_offset_px),
            left_px=f * left_px[is_agreeing],
            right_px=f * corrected_px[is_agreeing],
            motion=motion,
            turned_motion=turned_motion,
            ground=(_rank_correlation(*points[~is_low].T), _rank_correlation(*points[is_low].T)),
            is_late=not is_clean and self._is_late(),
        )

    def _rows(
        self, left_px: FloatArray, right_px: FloatArray
    ) -> tuple[RightView, BoolArray, FloatArray]:
        """The right view, (N,) whether points agree with it, and (N, 2) right points corrected by
        it without yaw.
        """
        is_used = _in_band(right_px[:, 1] - left_px[:, 1], _BAND_PX)
        view = RightView()
        for tolerance_px in (_GATE_PX, _ROW_PX):
            if is_used.sum() < _MIN_MATCHES:
                break
            view = fit_right_view(left_px[is_used], right_px[is_used], self._camera, has_yaw=True)
            row_px = view.corrected(right_px, self._camera)[:, 1] - left_px[:, 1]
            is_used = np.abs(row_px) < tolerance_px
        return view, is_used, replace(view, yaw_deg=0.0).corrected(right_px, self._camera)

    def _is_late(self) -> bool:
        """Whether one side repeats its images, or left images agree better with right images of
        other pairs.
        """
        n = self.n_pairs
        moves = [
            [_flow_px(one[i], one[i + 1]) for one in (self._lefts, self._rights)]
            for i in range(n - 1)
        ]
        n_repeated = sum(min(move) < _REPEATED_PX and max(move) > _MIN_FLOW_PX for move in moves)
        if n_repeated >= max(2, n // 3):
            return True
        agreement = {}
        for shift in range(-_MAX_SHIFT, _MAX_SHIFT + 1):
            firsts = [i for i in range(n) if 0 <= i + shift < n]
            counts = [
                _pair(self._lefts[i], self._rights[i + shift], self._camera.size_px).n_in_band(
                    _ROW_PX
                )
                for i in firsts[:: len(firsts) // _N_SHIFTED + 1]
            ]
            agreement[shift] = float(np.mean(counts)) if counts else 0.0
        return max(agreement.values()) > _MIN_GAIN * max(agreement[0], _MIN_MATCHES)

    def _motion(self, pair: IntArray, number: IntArray, disparity_px: FloatArray) -> Motion | None:
        supports, n_points = [], []
        for step in self._steps:
            rows = np.flatnonzero(pair == step.pair)
            _, first, second = np.intersect1d(number[rows], step.number, return_indices=True)
            d = disparity_px[rows[first]]
            if len(first) >= _MIN_MATCHES and np.ptp(np.quantile(d, (0.1, 0.9))) > _MIN_RANGE_PX:
                supports.append(_support(step.inverse_depth[second], step.parallax_px[second], d))
                n_points.append(len(first))
        if not supports:
            return None
        total = np.average(supports, axis=0, weights=n_points)  # (2, O)
        best = int(total[0].argmax())
        near = np.abs(_OFFSETS_PX - _OFFSETS_PX[best]) < 8.0
        each_px = [float(_OFFSETS_PX[near][support[0][near].argmax()]) for support in supports]
        is_likely = total[0] > 0.93 * total[0][best]
        half_px = max(0.75, float(np.ptp(_OFFSETS_PX[is_likely])) / 2)
        offset_px = float(
            np.average(_OFFSETS_PX[is_likely], weights=total[0][is_likely] - 0.93 * total[0][best])
        )
        sigma_px = math.hypot(half_px / 2, float(np.std(each_px)) / math.sqrt(len(each_px)))
        if is_likely[0] or is_likely[-1]:  # the offset may be beyond those that are tried
            sigma_px = math.inf
        f, own, other = self._factor, float(total[0][best]), float(total[1].max())
        return Motion(sum(n_points), len(n_points), own, f * offset_px, f * sigma_px, other)


def _support(
    inverse_depth: FloatArray, parallax_px: FloatArray, disparity_px: FloatArray
) -> FloatArray:
    """(2, O) fraction of the points that agree with each offset, as in the rig and exchanged."""
    chosen = np.random.default_rng(0).permutation(len(disparity_px))[:_N_SLOPES]
    shifted_px = disparity_px - _OFFSETS_PX[:, None]  # (O, N)
    with np.errstate(divide="ignore", invalid="ignore"):
        beta = inverse_depth[chosen] / shifted_px[:, chosen]  # (O, S)
    beta[np.abs(shifted_px[:, chosen]) < _BEHIND_PX] = np.nan
    error_px = (inverse_depth - beta[:, :, None] * shifted_px[:, None]) * parallax_px  # (O, S, N)
    agreement = np.clip(1 - (error_px / _POINT_PX) ** 2, 0.0, None)
    supports = []
    for sign in (1, -1):
        visible = np.where((sign * shifted_px > -_BEHIND_PX)[:, None], agreement, 0.0).mean(axis=2)
        supports.append(np.where(sign * beta > 0, visible, 0.0).max(axis=1))
    supports[1][np.abs(_OFFSETS_PX) > _SWAPPED_PX] = 0.0
    return np.array(supports)


def _flow_px(first: Features, second: Features) -> float:
    """Median motion of the matching features; 0 if there are none."""
    a, b = _matches(first, second)
    return (
        float(np.median(np.linalg.norm(second.xy_px[b] - first.xy_px[a], axis=1)))
        if len(a)
        else 0.0
    )


def _features(image: Image, n_features: int = _N_FEATURES) -> Features:
    """ORB features of the upper and the lower half of a grey image: on the road, features are few
    and weak.
    """
    # of ORB, which finds no features beside the image border
    half, border = image.shape[0] // 2, 31
    xy_px, angle_deg, descriptors = [np.zeros((0, 2))], [np.zeros(0)], [np.zeros((0, 32), np.uint8)]
    orb = cv2.ORB.create(nfeatures=n_features)
    for top, bottom in ((0, half + border), (half - border, image.shape[0])):
        points, described = orb.detectAndCompute(image[max(top, 0) : bottom], None)
        if len(points):
            xy_px.append(np.array([point.pt for point in points]) + np.array([0.0, max(top, 0)]))
            angle_deg.append(np.array([point.angle for point in points]))
            descriptors.append(np.asarray(described, np.uint8))
    return Features(np.concatenate(xy_px), np.concatenate(angle_deg), np.concatenate(descriptors))


def _matches(first: Features, second: Features) -> tuple[IntArray, IntArray]:
    """(N,) numbers of matching features, by cross-check and ratio test."""
    if min(len(first.xy_px), len(second.xy_px)) < 2:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    nearest = [
        (best.queryIdx, best.trainIdx)
        for best, other in matcher.knnMatch(first.descriptors, second.descriptors, k=2)
        if best.distance < _MAX_RATIO * other.distance
    ]
    chosen = np.array(nearest, np.int64).reshape(-1, 2)
    if len(chosen):
        back = [
            match.trainIdx
            for match in matcher.match(second.descriptors[chosen[:, 1]], first.descriptors)
        ]
        chosen = chosen[np.array(back) == chosen[:, 0]]
    return chosen[:, 0], chosen[:, 1]


def _pair(
    left: Features, right: Features, size_px: tuple[int, int], *, is_mirrored: bool = False
) -> _Pair:
    """The matches with the more frequent orientation, equal or opposite, in the more frequent band
    of rows.
    """
    first, second = _matches(left, right)
    turn_deg = np.abs((right.angle_deg[second] - left.angle_deg[first] + 180) % 360 - 180)
    kinds: tuple[Arrangement, Arrangement] = (
        ("mirrored", "flipped") if is_mirrored else ("equal", "turned")
    )
    pairs = []
    for kind, is_alike in zip(
        kinds, (turn_deg < _MAX_ANGLE_DEG, turn_deg > 180 - _MAX_ANGLE_DEG), strict=True
    ):
        right_px = right.xy_px[second[is_alike]]
        if kind in ("turned", "flipped"):
            right_px = np.array(size_px) - 1 - right_px
        pairs.append(
            _Pair(kind, len(first), left.xy_px[first[is_alike]], right_px, first[is_alike])
        )
    return max(pairs, key=lambda pair: pair.n_in_band())


def features(image: Image) -> Features:
    """The features of a small grey image, in half the number of a pair's."""
    return _features(image, _N_FEATURES // 2)


def in_equal_rows(first: Features, second: Features, size_px: tuple[int, int]) -> int:
    """Number of matching features in one narrow band of rows, of small images of this size."""
    return _pair(first, second, size_px).n_in_band(_ROW_PX / 2)


def _in_band(value: FloatArray, half_width: float) -> BoolArray:
    """(N,) whether values are in the band of the given half width that contains most values."""
    if not len(value):
        return np.zeros(0, np.bool_)
    ordered = np.sort(value)
    until = np.searchsorted(ordered, ordered + 2 * half_width, side="right")
    start = int((until - np.arange(len(ordered))).argmax())
    return np.asarray((value >= ordered[start]) & (value <= ordered[start] + 2 * half_width))


def _rank_correlation(first: FloatArray, second: FloatArray) -> float:
    """Spearman's correlation; 0 with too few values."""
    if len(first) < _MIN_MATCHES:
        return 0.0
    return float(np.corrcoef(first.argsort().argsort(), second.argsort().argsort())[0, 1])
