"""OutputCheck: whether what a network gives can be what its format says."""

from pathlib import Path

import numpy as np

from track_range.foundation.arrays import FloatArray32, Image
from track_range.foundation.errors import Note
from track_range.ranging.measurement.dense_map import Quantity
from track_range.ranging.networks.network_format import NetworkError

_RANGE_M = 0.1, 1000.0  # of depths that are metres
_MIN_CONTRAST = 5.0  # standard deviation of the grey levels of an image that shows something
# images in a row that are upside down at the start, and the least difference of their lower fifth
# from the band at half of their height, in the spread of all values (80 %)
_N_REVERSED, _MIN_DIFFERENCE = 5, 0.3

_TINY = float(np.finfo(np.float32).tiny)


class OutputCheck:
    """Removes values that cannot be: not positive, or depths in metres outside of 0.1 to 1000, and
    all values of an image in whose lower half, where the road is, most of them cannot be.

    A first image without any other value is an error, and so are five first images in which the
    depth rises towards the lower border, where the road is nearest: the format is then wrong.
    """

    def __init__(self, path: Path, is_metric: bool) -> None:
        self._path, self._is_metric = path, is_metric
        self._n_images, self._n_empty, self._n_reversed = 0, 0, 0
        self._is_proven = self._is_upright = False

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence about images without values."""
        if not self._n_empty:
            return ()
        return (
            Note(
                f"{self._path.name} gave nothing usable in {self._n_empty} of {self._n_images} "
                "images.",
                "network-empty",
                "warning",
                "methods",
            ),
        )

    def see(self, image: Image, values: FloatArray32, quantity: Quantity) -> None:
        """Set values that cannot be to NaN; NetworkError if the format is wrong."""
        self._n_images += 1
        low, high = self._limits(quantity)
        with np.errstate(invalid="ignore"):
            median = _typical(values)
            values[~(values >= min(low, _TINY))] = np.nan
            has_content = float(image[::8, ::8].std()) >= _MIN_CONTRAST
            if has_content and quantity != "disparity" and not self._is_upright:
                self._see_order(values, quantity)
            values[~((values >= low) & (values <= high))] = np.nan
        if self._is_metric and not low <= median <= high:
            values[:] = np.nan
        if np.isfinite(values).any():
            self._is_proven = True
            return
        self._n_empty += 1
        if has_content and not self._is_proven:
            raise NetworkError(
                f"{self._path}: expected {self._expected(quantity)}, found a median of "
                f"{median:.3g} in the first image; set `gives`, `metric`, `scale` or the input's "
                "`divisor`, `mean` and `std` in its MODEL.yaml."
            )

    def _limits(self, quantity: Quantity) -> tuple[float, float]:
        if quantity == "disparity":
            return _TINY, np.inf
        if not self._is_metric:
            return (_TINY if quantity == "depth" else -np.inf), np.inf
        if quantity == "depth":
            return _RANGE_M
        return 1 / _RANGE_M[1], 1 / _RANGE_M[0]

    def _expected(self, quantity: Quantity) -> str:
        if quantity == "disparity":
            return "positive disparities"
        if not self._is_metric:
            return "finite depths"
        return f"depths from {_RANGE_M[0]:g} to {_RANGE_M[1]:g} m"

    def _see_order(self, values: FloatArray32, quantity: Quantity) -> None:
        height = len(values)
        bottom, middle = values[-(height // 5) :], values[9 * height // 20 : 11 * height // 20]
        if not (np.isfinite(bottom).any() and np.isfinite(middle).any()):
            return
        spread = float(np.diff(np.nanpercentile(values, [10, 90]))[0])
        difference = float(np.nanmedian(bottom) - np.nanmedian(middle))
        rise = difference if quantity == "depth" else -difference
        if abs(difference) <= _MIN_DIFFERENCE * spread or spread == 0:
            return
        if rise < 0:
            self._is_upright = True
            return
        self._n_reversed += 1
        if self._n_reversed == _N_REVERSED:
            other = "inverse_depth" if quantity == "depth" else "depth"
            raise NetworkError(
                f"{self._path}: expected depths that fall towards the lower border, "
                "where a road is "
                f"nearest, found the reverse in {_N_REVERSED} images; set `gives: {other}` in its "
                "MODEL.yaml."
            )


def _typical(values: FloatArray32) -> float:
    """The median in the lower half of an image, else in all of it; 0 is no value. NaN = none."""
    for part in (values[len(values) // 2 :], values):
        given = part[np.isfinite(part) & (part != 0)]
        if given.size:
            return float(np.median(given))
    return float("nan")
