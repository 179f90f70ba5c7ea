"""The surface of the object at the centre of each box, from a dense map of disparities.

The surfaces, and the choice between them, are those of the patch matcher (`surfaces`,
`surface_choice`): only the disparities of a box's windows are read from a map, each as the median
of a few of its pixels, and not matched. So an object behind a pole, beside a nearer vehicle or with
the background in its windows has the disparity of its own pixels, at the box's centre.

    sigma^2 = floor^2 + (floor_fraction d)^2 + (scatter_fraction scatter)^2 + (tilt_fraction tilt)^2
              + choice^2

with the terms of `PatchMatcher`: the scatter of the windows about their surface, its tilt across
the box, and the disparities of the other surfaces by their probabilities. Errors that all pixels of
an object share are not in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32
from track_range.stereo.matching.patch_matches import ExpectedDisparity
from track_range.stereo.matching.surface_choice import (
    OF_MAPS,
    choose_surface,
    features,
)
from track_range.stereo.matching.surfaces import (
    centre_weights,
    find_surfaces,
    fit_surfaces,
    surface_terms,
)

_N_SIDE, _N_SUB = 9, 3  # windows per side of a box, and sampled pixels per side of a window
# of a box's sides that its windows cover, about its centre; the rest is mostly background
_BOX_FRACTION = 0.6
_MIN_SIDE_PX = 2.0  # smallest side of a box, px of the map
MIN_KNOWN = 0.2  # smallest fraction of windows with a known pixel
_MIN_PROBABILITY = 0.4  # smallest probability of the surface to be the object
_WELL_MATCHED_BITS = 5.0  # cost of all windows, for the choice
# Parts of sigma, as in `PatchMatcherSettings`: 1 and 2 sigma hold 68 and 95 % of the errors in maps
# of the simulation (seeds 0-9) with noise, blur, holes, at lower resolution, and of semi-global
# matching.
_FLOOR_PX, _FLOOR_FRACTION = 0.1, 0.008
SCATTER_FRACTION, _TILT_FRACTION = 0.6, 0.12


@dataclass(frozen=True, slots=True)
class MapWindows:
    """The windows of N boxes in a map, G each, as `surfaces.BoxWindows`."""

    index: FloatArray  # (N, G) disparities, px of the map; 0 where unknown
    weight: FloatArray  # (N, G) fraction of known pixels, times their confidence; 0 = unknown
    u: FloatArray  # (N, G) position right of the box's centre, in box widths
    v: FloatArray  # (N, G) position below the box's centre, in box heights
    is_used: BoolArray  # (N, G) windows inside the map
    first_px: FloatArray  # (N,) 0: `index` are disparities
    scale: FloatArray  # (2, N) 1

    @property
    def first(self) -> FloatArray:
        """(N,) disparity of index 0."""
        return self.first_px


def map_windows(
    disparity: FloatArray32, xyxy_px: FloatArray, confidence: FloatArray32 | None = None
) -> MapWindows:
    """The windows of boxes (N, 4), in pixels of a map (h, w) of disparities, NaN = unknown."""
    n, n_places = len(xyxy_px), _N_SIDE * _N_SUB
    size_px = np.array(disparity.shape[::-1])[:, None]
    centre_px = ((xyxy_px[:, :2] + xyxy_px[:, 2:]) / 2)[:, :, None]
    side_px = (xyxy_px[:, 2:] - xyxy_px[:, :2])[:, :, None]
    step = ((np.arange(n_places) + 0.5) / n_places - 0.5) * _BOX_FRACTION
    place_px = np.rint(centre_px + side_px * step)  # (N, 2, 27) columns and rows
    is_inside = (place_px >= 0) & (place_px < size_px)
    column, row = np.clip(place_px, 0, size_px - 1).astype(np.int64).swapaxes(0, 1)
    pixels = np.s_[row[:, :, None], column[:, None, :]]
    in_map = is_inside[:, 1, :, None] & is_inside[:, 0, None, :]

    def by_window(values: FloatArray | BoolArray) -> FloatArray:
        parts = values.reshape(n, _N_SIDE, _N_SUB, _N_SIDE, _N_SUB).swapaxes(2, 3)
        return np.asarray(parts.reshape(n, _N_SIDE**2, _N_SUB**2), np.float64)

    read = disparity[pixels]
    is_known = in_map & np.isfinite(read) & (read > 0)
    trust = is_known if confidence is None else np.where(is_known, confidence[pixels], 0.0)
    n_known = by_window(is_known).sum(axis=2).astype(np.int64)
    ordered = np.sort(by_window(np.where(is_known, read, np.inf)), axis=2)
    middle = np.maximum(n_known - 1, 0)[..., None] // 2
    median = np.take_along_axis(ordered, middle, axis=2)[..., 0]
    # of the pixels that were read: in a small box, several places are one pixel
    place = ((place_px - centre_px) / side_px).reshape(n, 2, _N_SIDE, _N_SUB).mean(axis=3)
    grid = np.empty((2, n, _N_SIDE, _N_SIDE))
    grid[0], grid[1] = place[:, 0, None, :], place[:, 1, :, None]
    u, v = grid.reshape(2, n, -1)
    return MapWindows(
        np.where(n_known > 0, median, 0.0),
        by_window(trust).mean(axis=2),
        u,
        v,
        np.asarray(by_window(in_map).any(axis=2)),
        np.zeros(n),
        np.ones((2, n)),
    )


def map_surfaces(
    disparity: FloatArray32,
    xyxy_px: FloatArray,
    confidence: FloatArray32 | None = None,
    *,
    min_known: float = MIN_KNOWN,
    scatter_fraction: float = SCATTER_FRACTION,
) -> tuple[FloatArray, FloatArray]:
    """Disparity at the centre of boxes (N, 4) in pixels of a map, and its standard deviation, (N,)
    px of the map each.

    `disparity` (h, w) is in px of the map, NaN or not above 0 = unknown; `confidence` (h, w) are
    weights from 0 to 1; for the other arguments, see `box_surfaces` of `ranging.measurement`. NaN
    for boxes that show too few known pixels or no surface that probably is the object, that are
    smaller than 2 px of the map, or not finite.
    """
    measured = np.full((2, len(xyxy_px)), np.nan)
    with np.errstate(invalid="ignore"):
        # far outside, pixel numbers would not fit into integers
        is_near = (np.abs(xyxy_px) < 10 * max(disparity.shape)).all(axis=1)
        is_large = (xyxy_px[:, 2:] - xyxy_px[:, :2] >= _MIN_SIDE_PX).all(axis=1)
    rows = np.flatnonzero(is_near & is_large)
    if len(rows):
        windows = map_windows(disparity, xyxy_px[rows], confidence)
        measured[:, rows] = _measured(windows, min_known, scatter_fraction)
    return measured[0], measured[1]


def _measured(windows: MapWindows, min_known: float, scatter_fraction: float) -> FloatArray:
    """(2, N) disparities at the boxes' centres and their standard deviations, px of the map."""
    n = len(windows.u)
    rows, unknown = np.arange(n), np.full(n, np.nan)
    surfaces = find_surfaces(windows.index, windows.weight, windows)
    phi = features(
        surfaces,
        windows,
        np.full(windows.u.shape, _WELL_MATCHED_BITS),
        by_size=ExpectedDisparity.unknown(n),
        track_px=unknown,
        others_fraction=np.zeros(windows.u.shape),
    )
    choice = choose_surface(phi, surfaces, OF_MAPS)
    is_object = surfaces.is_member[choice.chosen, rows]
    terms = surface_terms(windows.u, windows.v)
    weight = windows.weight * centre_weights(windows.u, windows.v)
    fit = fit_surfaces(
        windows.index,
        np.where(is_object, weight, 0.0),
        terms,
        disparity=np.maximum(np.nan_to_num(surfaces.disparity[choice.chosen, rows]), 0.1),
        is_curved=True,
    )
    d = fit.p[:, 0]
    residual = np.where(is_object, np.abs(windows.index - fit.at_terms(terms)), 0.0)
    scatter = 1.25 * residual.sum(axis=1) / np.maximum(is_object.sum(axis=1), 1)
    tilt = np.abs(fit.p[:, 1:3]).sum(axis=1) / 2
    difference = np.where(np.isfinite(surfaces.centre), surfaces.centre - d, 0.0)
    is_other = np.arange(len(difference))[:, None] != choice.chosen
    variance = np.where(is_other, choice.probability * difference**2, 0.0).sum(axis=0)
    for sigma in (
        _FLOOR_PX,
        _FLOOR_FRACTION * d,
        scatter_fraction * scatter,
        _TILT_FRACTION * tilt,
    ):
        variance = variance + np.square(sigma)
    is_known = (windows.weight > 0).mean(axis=1) >= min_known
    is_measured = is_known & (choice.probability[choice.chosen, rows] >= _MIN_PROBABILITY) & (d > 0)
    return np.where(is_measured, np.array([d, np.sqrt(variance)]), np.nan)
