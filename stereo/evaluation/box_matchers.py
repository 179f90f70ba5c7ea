"""Stereo matchers by name, and their comparison on pairs with true disparities.

patch                                       track-range's patch matcher
sgbm                                        dense matching as in a run: the surface of the object in each box
sgbm-3way, sgbm-5way, sgbm-hh, sgbm-hh4     dense matching with other aggregation directions (OpenCV's modes)
NAME-centre                                 a dense matcher, sampled at the centre pixel of the box (Guo Pengyu)
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.stereo.evaluation.disparity_errors import MatcherColumn, Objects
from track_range.stereo.evaluation.kitti_2015 import StereoPair
from track_range.stereo.geometry.frames import ImageView, whole_image
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.dense_surfaces import map_surfaces
from track_range.stereo.matching.patch_matcher import PatchMatcher, PatchMatcherSettings
from track_range.stereo.matching.patch_matches import (
    BoxMatcher,
    ExpectedDisparity,
    Outcome,
    PatchMatches,
)
from track_range.stereo.matching.sgbm import (
    Mode,
    Sgbm,
    SgbmSettings,
    centre_disparity,
)

CENTRE = "-centre"
_MODE: dict[str, Mode] = {
    "sgbm-3way": "3way",
    "sgbm-5way": "sgbm",
    "sgbm-hh": "hh",
    "sgbm-hh4": "hh4",
}

MATCHER_NAMES = ("patch", *(name + end for name in ("sgbm", *_MODE) for end in ("", CENTRE)))


class DenseMatcher:
    """Matcher that samples dense disparities in boxes; priors are not used."""

    def __init__(self, settings: SgbmSettings, *, is_centre: bool = False) -> None:
        self._sgbm, self._settings = Sgbm(settings), settings
        self._is_centre = is_centre

    def match(
        self,
        left: Image,
        right: ImageView,
        xyxy_px: FloatArray,
        prior_px: FloatArray,
        by_size: ExpectedDisparity | None = None,
    ) -> PatchMatches:
        """See `BoxMatcher.match`; the outcome of boxes without a disparity is NO_TEXTURE."""
        dense = self._sgbm.dense_disparity(left, whole_image(right))
        settings = self._settings
        if self._is_centre:
            disparity_px, sigma_px = centre_disparity(dense, xyxy_px, settings=settings)
        else:
            disparity_px, sigma_px = map_surfaces(
                dense,
                xyxy_px,
                min_known=settings.min_valid_share,
                scatter_fraction=settings.shape_share,
            )
        outcome = np.where(np.isnan(disparity_px), int(Outcome.NO_TEXTURE), int(Outcome.MATCHED))
        return PatchMatches.of(disparity_px, sigma_px, outcome)


def open_matcher(name: str, rig: StereoRig) -> BoxMatcher:
    """The matcher called `name`, with the settings that a run uses for `rig`; ValueError for
    unknown names.
    """
    if name not in MATCHER_NAMES:
        raise ValueError(f"unknown matcher '{name}': expected one of {', '.join(MATCHER_NAMES)}")
    if name == "patch":
        return PatchMatcher(PatchMatcherSettings.for_rig(rig))
    mode = _MODE.get(name.removesuffix(CENTRE))
    chosen: Mapping[str, Any] = {"mode": mode} if mode else {}
    return DenseMatcher(SgbmSettings.for_rig(rig, chosen=chosen), is_centre=name.endswith(CENTRE))


@dataclass(frozen=True, slots=True)
class MatcherResults:
    """Disparities of the objects of all pairs by several matchers."""

    objects: Objects
    columns: dict[str, MatcherColumn]  # by name of the matcher
    # median time per pair on one thread, milliseconds, by name of the matcher
    ms_per_frame: dict[str, float]
    notes: tuple[str, ...] = ()  # messages for the user, without duplicates


# disparities of the objects of a pair by their classes' sizes
Expectation = Callable[[StereoPair], ExpectedDisparity]


class _MatcherRun:
    """A matcher on one pair after the other; the last disparity of a track is the prior in the next
    pair.
    """

    def __init__(self, matcher: BoxMatcher | str) -> None:
        self._matcher = matcher  # a name: opened with the settings for each rig
        self._last_px: dict[int, float] = {}  # by track, of the last pair
        self._disparity_px: list[FloatArray] = [np.zeros(0)]  # of each pair
        self._sigma_px: list[FloatArray] = [np.zeros(0)]
        self._times_ms: list[float] = []

    def match(self, pair: StereoPair, by_size: ExpectedDisparity | None) -> None:
        """Measure the objects of a pair."""
        matcher = self._matcher
        if isinstance(matcher, str):
            matcher = open_matcher(matcher, pair.rig)
        # objects without tracks have no priors
        tracks = pair.track_id.tolist() or [-1] * len(pair.true_px)
        prior_px = np.array([self._last_px.get(track, np.nan) for track in tracks])
        start_s = time.perf_counter()
        matches = matcher.match(pair.left, pair.right, pair.xyxy_px, prior_px, by_size)
        self._times_ms.append(1e3 * (time.perf_counter() - start_s))
        self._disparity_px.append(matches.disparity_px)
        self._sigma_px.append(matches.sigma_px)
        measured = zip(tracks, matches.disparity_px.tolist(), strict=True)
        self._last_px = {track: disparity for track, disparity in measured if track >= 0}

    @property
    def column(self) -> MatcherColumn:
        """The disparities of all objects."""
        return MatcherColumn(np.concatenate(self._disparity_px), np.concatenate(self._sigma_px))

    @property
    def ms_per_frame(self) -> float | None:
        """Median time per pair, milliseconds; None without pairs."""
        return float(np.median(self._times_ms)) if self._times_ms else None


def measure_pairs(
    pairs: Iterable[StereoPair],
    names: Sequence[str],
    *,
    expected: Expectation | None = None,
    others: Mapping[str, BoxMatcher] | None = None,
) -> MatcherResults:
    """Run several matchers, by their names (`MATCHER_NAMES`), and then `others`, on the same pairs,
    which are read one by one.

    As in a run, the last disparity of a track (`StereoPair.track_id`) is the prior in the next
    pair; other objects are searched in the full range. `expected` gives the expected disparities of
    the objects of a pair; None = unknown. Raises ValueError for unknown names.
    """
    chosen: dict[str, BoxMatcher | str] = {name: name for name in names}
    chosen |= others or {}
    runs = {name: _MatcherRun(matcher) for name, matcher in chosen.items()}
    notes = dict[str, None]()
    objects = [_no_objects()]
    for number, pair in enumerate(pairs):
        notes |= dict.fromkeys(pair.notes)
        by_size = None if expected is None else expected(pair)
        for run in runs.values():
            run.match(pair, by_size)
        objects.append(_objects(pair, number))
    times_ms = {name: run.ms_per_frame for name, run in runs.items()}
    return MatcherResults(
        _joined(objects),
        {name: run.column for name, run in runs.items()},
        {name: ms for name, ms in times_ms.items() if ms is not None},
        tuple(notes),
    )


def _no_objects() -> Objects:
    none, none_int = np.zeros(0), np.zeros(0, np.int64)
    return Objects(none, none, none, none_int, none_int, ())


def _objects(pair: StereoPair, number: int) -> Objects:
    """The objects of the pair with this number; those without tracks are one group."""
    n = len(pair.true_px)
    numbers = np.full(n, number)
    return Objects(
        true_px=pair.true_px,
        focal_baseline_m=np.full(n, pair.rig.left.fx_px * pair.rig.baseline_m),
        x_px=pair.x_px,
        pair=numbers,
        group=pair.track_id if len(pair.track_id) else numbers,
        cameras=(pair.rig.left,),
    )


def _joined(objects: Sequence[Objects]) -> Objects:
    """All objects; those of pairs without a common track are groups by pair: single images."""
    pair = np.concatenate([part.pair for part in objects])
    group = np.concatenate([part.group for part in objects])
    if np.unique(np.stack([group, pair]), axis=1).shape[1] == len(np.unique(group)):
        group = pair
    return Objects(
        true_px=np.concatenate([part.true_px for part in objects]),
        focal_baseline_m=np.concatenate([part.focal_baseline_m for part in objects]),
        x_px=np.concatenate([part.x_px for part in objects]),
        pair=pair,
        group=group,
        cameras=tuple(camera for part in objects for camera in part.cameras),
    )
