"""Stereo matchers by name, and their comparison on pairs with true disparities.

patch                                       track-range's patch matcher
sgbm                                        dense matching as in a run: median of the inner half of each box
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
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import ImageView, whole_image
from track_range.stereo.geometry.rig import StereoRig
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
    inner_half_median,
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
        self._read = centre_disparity if is_centre else inner_half_median

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
        disparity_px, sigma_px = self._read(dense, xyxy_px, settings=self._settings)
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


def measure_pairs(
    pairs: Iterable[StereoPair], names: Sequence[str], *, expected: Expectation | None = None
) -> MatcherResults:
    """Run several matchers, by their names (`MATCHER_NAMES`), on the same pairs, which are read one
    by one.

    As in a run, the last disparity of a track (`StereoPair.track_id`) is the prior in the next
    pair; other objects are searched in the full range. `expected` gives the expected disparities of
    the objects of a pair; None = unknown. Raises ValueError for unknown names.
    """
    notes = dict[str, None]()
    cameras = list[PinholeCamera]()
    none, none_int = np.zeros(0), np.zeros(0, np.int64)
    columns: list[tuple[Any, ...]] = [(none, none, none, none_int, none_int)]  # those of `Objects`
    measured: dict[str, list[tuple[FloatArray, FloatArray]]] = {
        name: [(none, none)] for name in names
    }
    times_ms: dict[str, list[float]] = {name: [] for name in names}
    last_px: dict[str, dict[int, float]] = {name: {} for name in names}
    for number, pair in enumerate(pairs):
        notes |= dict.fromkeys(pair.notes)
        n_objects = len(pair.true_px)
        ids = pair.track_id.tolist() or [-1] * n_objects
        for name in measured:
            matcher, last = open_matcher(name, pair.rig), last_px[name]
            prior_px = np.array([last.get(track, np.nan) for track in ids])
            by_size = None if expected is None else expected(pair)
            start_s = time.perf_counter()
            matches = matcher.match(pair.left, pair.right, pair.xyxy_px, prior_px, by_size)
            times_ms[name].append(1e3 * (time.perf_counter() - start_s))
            measured[name].append((matches.disparity_px, matches.sigma_px))
            last_px[name] = {
                n: d for n, d in zip(ids, matches.disparity_px.tolist(), strict=True) if n >= 0
            }
        cameras.append(pair.rig.left)
        focal_baseline_m = np.full(n_objects, pair.rig.left.fx_px * pair.rig.baseline_m)
        numbers = np.full(n_objects, number)
        group = pair.track_id if len(pair.track_id) else numbers
        columns.append((pair.true_px, focal_baseline_m, pair.x_px, numbers, group))
    true_px, focal_baseline_m, x_px, pair_number, group = map(
        np.concatenate, zip(*columns, strict=True)
    )
    return MatcherResults(
        Objects(true_px, focal_baseline_m, x_px, pair_number, group, tuple(cameras)),
        {
            name: MatcherColumn(*map(np.concatenate, zip(*parts, strict=True)))
            for name, parts in measured.items()
        },
        {name: float(np.median(times)) for name, times in times_ms.items() if times},
        tuple(notes),
    )
