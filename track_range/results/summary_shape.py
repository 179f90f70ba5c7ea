"""What a summary.json may hold: of one that was damaged, edited or written by another version, what fits is still told.

A shape is the name of a kind of leaf, a list of one shape, or a mapping of names to shapes, in which "*" stands for all
other names and `_NEEDED` lists those without which the mapping says nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

_NEEDED = "!"

_FIGURES = {"*": "figure"}
_ANYTHING = {"*": "anything"}
_ROW = {
    "*": "figure",
    "bands": [{"*": "figure", _NEEDED: ("from_m", "to_m")}],
    "by_class": {"*": _FIGURES},
}
_SUMMARY: dict[str, Any] = {
    **dict.fromkeys(("frames", "starts_s", "wall_s", "frames_per_s", "focal_px", "baseline_m"), "figure"),
    **dict.fromkeys(("truth", "calibration"), "text"),
    **dict.fromkeys(("stages_ms", "closing", "stereo_unmatched"), _FIGURES),
    **{key: {"*": _ROW} for key in ("methods", "common")},
    **dict.fromkeys(("inputs", "settings", "versions"), _ANYTHING),
    "tracks": {"*": "figure", "classes": ["text"]},
    "alignment": {"*": "figure", "source": "text", "is_applied": "anything"},
    "learnt_scale": {"*": "figure", _NEEDED: ("n_tracks", "baseline_m", "focal_px", "relative_sigma")},
    "files": {"*": "text"},
    "notes": ["text"],
    "*": "anything",
}

_LARGEST = 1e15
"""No figure of a run is larger; and it is neither NaN nor infinite."""

_LEAVES: dict[str, Callable[[Any], bool]] = {
    "figure": lambda value: isinstance(value, int | float) and abs(value) < _LARGEST,
    "text": lambda value: isinstance(value, str),
    "anything": lambda value: True,
}


class _Misfit(Exception):
    """A value of another shape."""


def fitting_summary(summary: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """The part of a summary that is as it should be, and the dotted names of what was left out."""
    misfits: list[str] = []
    return _fit_mapping(summary, _SUMMARY, "", misfits), misfits


def _fit(value: Any, shape: Any, name: str, misfits: list[str]) -> Any:
    """The value without its parts that do not fit, which are added to `misfits`; null is a leaf that is not known."""
    if isinstance(shape, str):
        if value is None or _LEAVES[shape](value):
            return value
    elif isinstance(shape, list):
        if isinstance(value, list):
            return _fit_list(value, shape[0], name, misfits)
    elif isinstance(value, Mapping):
        return _fit_mapping(value, shape, name, misfits)
    raise _Misfit


def _fit_list(values: list[Any], shape: Any, name: str, misfits: list[str]) -> list[Any]:
    numbered = {str(number): value for number, value in enumerate(values)}
    return list(_fit_mapping(numbered, {"*": shape}, name, misfits).values())


def _fit_mapping(values: Mapping[str, Any], shape: Mapping[str, Any], name: str, misfits: list[str]) -> dict[str, Any]:
    found = {}
    for key, value in values.items():
        full_name = f"{name}.{key}" if name else str(key)
        try:
            found[str(key)] = _fit(value, shape.get(key, shape["*"]), full_name, misfits)
        except _Misfit:
            misfits.append(full_name)
    if any(found.get(key) is None for key in shape.get(_NEEDED, ())):
        raise _Misfit
    return found
