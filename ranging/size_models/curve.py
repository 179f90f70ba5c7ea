"""What a curve file knows of sizes: loads it, whatever kind of model it holds.

`cuboids` (packaged): priors over sizes, aspect and the ground (`cuboid_sizes.py`). `log-linear`: a curve per class
(`log_linear_sizes.py`). `table`: a plain curve, such as the paper's polynomial, made safe (`table_sizes.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from track_range.ranging.size_models import cuboid_sizes
from track_range.ranging.size_models import log_linear as log_linear_sizes
from track_range.ranging.size_models import tables as table_sizes
from track_range.ranging.size_models.curve_file import CURVE_VERSION, CurveError, read_curve_file
from track_range.ranging.size_models.log_linear import SizeCurve, SizeCurves
from track_range.ranging.size_models.size_model import SizeModel

__all__ = ["CURVE_VERSION", "CurveError", "SizeCurve", "SizeCurves", "SizeModel", "load_curves"]

_READERS: Mapping[str, Callable[[Mapping[str, Any]], SizeModel]] = {
    cuboid_sizes.KIND: cuboid_sizes.cuboids_in,
    log_linear_sizes.KIND: log_linear_sizes.log_linear_in,
    table_sizes.KIND: table_sizes.tables_in,
}


def load_curves(path: Path | None = None) -> SizeModel:
    """The model in a curve file; None = the packaged one.

    Raises:
        CurveError: no such file, not our format or version, an unknown kind or class, numbers that make no sense.
    """
    name, document = read_curve_file(path)
    kind = str(document.get("kind"))
    if kind not in _READERS:
        raise CurveError(f"{name}: curves of kind {kind}; of {', '.join(_READERS)}.")
    try:
        return _READERS[kind](document)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise CurveError(f"{name}: not a curve file of track-range ({error!r}).") from error
