"""The matchers by name, each as a disparity per box, and how they are measured side by side on pairs with a truth.

patch                                       the patch matcher, the program's own
sgbm                                        dense, as the main run does it: the inner half's median
sgbm-3way, sgbm-5way, sgbm-hh, sgbm-hh4     dense, by the directions it smooths along (OpenCV's modes)
NAME-centre                                 any dense one read at the box's middle pixel (Guo's binocular paper)
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.stereo.evaluation.disparity_errors import Column, Objects
from track_range.stereo.evaluation.kitti_2015 import StereoPair
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import ImageView, whole_image
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patch_matcher import PatchMatcher, PatchMatcherSettings
from track_range.stereo.matching.patch_matches import BoxMatcher, Outcome, PatchMatches
from track_range.stereo.matching.sgbm import Mode, Sgbm, SgbmSettings, centre_disparity, inner_half_median

CENTRE = "-centre"
_MODE: dict[str, Mode] = {"sgbm-3way": "3way", "sgbm-5way": "sgbm", "sgbm-hh": "hh", "sgbm-hh4": "hh4"}

MATCHER_NAMES = ("patch", *(name + end for name in ("sgbm", *_MODE) for end in ("", CENTRE)))


class DenseMatcher:
    """Reads boxes from the disparity of the whole image; priors do not serve it."""

    def __init__(self, settings: SgbmSettings, *, is_centre: bool = False) -> None:
        self._sgbm, self._settings = Sgbm(settings), settings
        self._read = centre_disparity if is_centre else inner_half_median

    def match(self, left: Image, right: ImageView, xyxy_px: FloatArray, prior_px: FloatArray) -> PatchMatches:
        """As `BoxMatcher.match`; a box without a disparity counts as one without texture."""
        dense = self._sgbm.dense_disparity(left, whole_image(right))
        disparity_px, sigma_px = self._read(dense, xyxy_px, settings=self._settings)
        outcome = np.where(np.isnan(disparity_px), int(Outcome.NO_TEXTURE), int(Outcome.MATCHED))
        return PatchMatches(disparity_px, sigma_px, outcome)


def open_matcher(name: str, rig: StereoRig) -> BoxMatcher:
    """The matcher of a name, set for a rig as the main run sets it.

    Raises:
        ValueError: there is none of this name.
    """
    if name not in MATCHER_NAMES:
        raise ValueError(f"'{name}' is no matcher; there are: {', '.join(MATCHER_NAMES)}")
    if name == "patch":
        return PatchMatcher(PatchMatcherSettings.for_rig(rig))
    mode = _MODE.get(name.removesuffix(CENTRE))
    chosen: Mapping[str, Any] = {"mode": mode} if mode else {}
    return DenseMatcher(SgbmSettings.for_rig(rig, chosen=chosen), is_centre=name.endswith(CENTRE))


@dataclass(frozen=True, slots=True)
class Measured:
    """What matchers read of the objects of all pairs.

    Attributes:
        objects: N of them, with their truth.
        columns: by name of the matcher, N rows each.
        ms_per_frame: by name, median time of a pair with all its boxes, on one thread.
        notes: what the user should know, each once.
    """

    objects: Objects
    columns: dict[str, Column]
    ms_per_frame: dict[str, float]
    notes: tuple[str, ...] = ()


def measure_pairs(pairs: Iterable[StereoPair], names: Sequence[str]) -> Measured:
    """Run matchers side by side over pairs.

    A drive's track (`StereoPair.track_id`) that was matched in the pair before is searched about where it was, as in a
    run; all else over the full range.

    Args:
        pairs: read one by one.
        names: of the matchers, see `MATCHER_NAMES`.

    Raises:
        ValueError: an unknown name.
    """
    parts, notes = _Parts(names), dict[str, None]()
    for pair in pairs:
        notes |= dict.fromkeys(pair.notes)
        with one_thread():
            parts.add(pair)
    return parts.measured(tuple(notes))


@contextmanager
def one_thread() -> Iterator[None]:
    """OpenCV on one thread, and on as many as before after it."""
    n_before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(n_before)


class _Parts:
    """Rows of all matchers so far, pair by pair; images are not kept."""

    def __init__(self, names: Sequence[str]) -> None:
        self._objects = [_no_objects()]
        self._cameras: list[PinholeCamera] = []
        self._found: dict[str, list[tuple[FloatArray, FloatArray]]] = {name: [_NOTHING] for name in names}
        self._ms: dict[str, list[float]] = {name: [] for name in names}
        self._last: dict[str, dict[int, float]] = {name: {} for name in names}

    def add(self, pair: StereoPair) -> None:
        ids = pair.track_id.tolist() or [-1] * len(pair.true_px)
        for name in self._found:
            matcher, last = open_matcher(name, pair.rig), self._last[name]
            prior_px = np.array([last.get(number, np.nan) for number in ids])
            began_s = time.perf_counter()
            found = matcher.match(pair.left, pair.right, pair.xyxy_px, prior_px)
            self._ms[name].append(1e3 * (time.perf_counter() - began_s))
            self._found[name].append((found.disparity_px, found.sigma_px))
            self._last[name] = {n: d for n, d in zip(ids, found.disparity_px.tolist(), strict=True) if n >= 0}
        self._objects.append(_objects_of(pair, number=len(self._cameras)))
        self._cameras.append(pair.rig.left)

    def measured(self, notes: tuple[str, ...]) -> Measured:
        columns = {
            name: Column(*(np.concatenate([part[i] for part in parts]) for i in (0, 1)))
            for name, parts in self._found.items()
        }
        joined = {
            part: np.concatenate([getattr(objects, part) for objects in self._objects])
            for part in ("true_px", "focal_baseline_m", "x_px", "pair", "group")
        }
        ms = {name: float(np.median(each)) for name, each in self._ms.items() if each}
        return Measured(Objects(**joined, cameras=tuple(self._cameras)), columns, ms, notes)


_NOTHING = (np.zeros(0), np.zeros(0))


def _no_objects() -> Objects:
    none = np.zeros(0, np.int64)
    return Objects(np.zeros(0), np.zeros(0), np.zeros(0), pair=none, group=none, cameras=())


def _objects_of(pair: StereoPair, *, number: int) -> Objects:
    n = len(pair.true_px)
    return Objects(
        true_px=pair.true_px,
        focal_baseline_m=np.full(n, pair.rig.left.fx_px * pair.rig.baseline_m),
        x_px=pair.x_px,
        pair=np.full(n, number),
        group=pair.track_id if len(pair.track_id) else np.full(n, number),
        cameras=(pair.rig.left,),
    )
