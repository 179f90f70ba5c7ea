"""What a run's summary says in words: its name, the figures to see first, where its metres come from, its settings.

An error of a disparity d by e pixels moves a distance Z = f B / d by about Z^2 e / (f B).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from track_range.report import tables
from track_range.stereo.alignment.model import MAX_ROW_OFFSET_PX

Summary = Mapping[str, Any]

SETTINGS_GROUPS = {"inputs": "Inputs", "settings": "Settings", "versions": "Versions"}
"""Parts of a summary that are shown as they are, with their headings."""

_FAR_M = 50.0
"""Where the effect of a wrong disparity is told."""


def run_name(summary: Summary) -> str:
    """The inputs' names, each with its folder's: what a reader calls the run."""
    inputs = summary.get("inputs") or {}
    named = [str(inputs[key]) for key in ("left", "right", "video", "mono") if inputs.get(key)]
    return " + ".join("/".join(Path(name).parts[-2:]) for name in named) or "A run"


def cards(summary: Summary) -> Iterator[dict[str, str]]:
    """The figures to see first: frames, speed, tracks, the best method, how well identities were kept."""
    wall_s, fps = tables.figure(summary, "wall_s"), tables.frames_per_s(summary)
    tracks = summary.get("tracks") or {}
    yield card("frames", summary.get("frames"), f"in {wall_s:.1f} s" if wall_s else "")
    if fps is not None:
        yield card("frames per second", f"{fps:.1f}", "all stages, wall clock")
    yield card("tracks", tracks.get("n"), "confirmed road users")
    yield from _error_cards(summary)
    hota, idsw = tables.figure(tracks, "hota"), tables.figure(tracks, "idsw")
    if hota is not None:
        switches = "" if idsw is None else f"{idsw:.0f} identity switch{'' if idsw == 1 else 'es'}"
        yield card("HOTA", f"{hota:.1f} %", switches)


def _error_cards(summary: Summary) -> Iterator[dict[str, str]]:
    """The error of `fused`, what a run says in the end; the best method is found only with the truth in hand."""
    best = best_method(summary)
    if best is None:
        return
    name, error_pct, where = best
    fused = (summary.get("methods") or {}).get("fused") or {}
    fused_pct, n = (tables.figure(fused, key) for key in ("median_relative_error_pct", "n"))
    if fused_pct is None or name == "fused":
        yield card("median distance error", f"{error_pct:.1f} %", f"{name}, the best {where}")
        return
    of = "" if n is None else f" in {n:.0f} track-frames"
    yield card("median distance error", f"{fused_pct:.1f} %", f"fused{of}; best: {name} {error_pct:.1f} % {where}")


def card(name: str, value: object, detail: str) -> dict[str, str]:
    """One card; a value that is None was not measured."""
    return {"name": name, "value": tables.NOTHING if value is None else str(value), "detail": detail}


def best_method(summary: Summary) -> tuple[str, float, str] | None:
    """Name and median relative error of the best method and where it is best, None without truth.

    Common coverage decides where there is one: elsewhere a method may win by refusing the hard ones.
    """
    for part, where in (("common", "on common coverage"), ("methods", "where it measured")):
        found = {
            name: error
            for name, row in (summary.get(part) or {}).items()
            if (error := tables.figure(row, "median_relative_error_pct")) is not None
        }
        if found:
            name = min(found, key=lambda each: found[each])
            return name, found[name], where
    return None


def geometry_words(summary: Summary) -> list[str]:
    """Where the metres come from and how well the two eyes agree, in plain sentences."""
    found = [_metres(summary), _learnt(summary.get("learnt_scale") or {})]
    alignment = summary.get("alignment")
    if alignment:
        found += [_rows(alignment), _disparities(alignment), _effect(alignment, summary)]
    return [sentence for sentence in found if sentence]


def _metres(summary: Summary) -> str:
    rig = (summary.get("inputs") or {}).get("rig")
    return {
        "rig": f"Metres come from a calibration{f': {rig}' if rig else ' found beside the video'}.",
        "focal length": "Metres come from the focal length that was given; nobody has calibrated the lens.",
        "estimated": "Uncalibrated: metres are estimated from the sizes of road users, and no better than that.",
    }.get(str(summary.get("calibration")), "")


def _learnt(scale: Mapping[str, Any]) -> str:
    if not scale:
        return ""
    return (
        f"The sizes of {scale['n_tracks']} tracks say a baseline of {scale['baseline_m']:.2f} m at a focal length of "
        f"{scale['focal_px']:.0f} px: all distances may be wrong by {100 * scale['relative_sigma']:.0f} % together."
    )


def _rows(alignment: Mapping[str, Any]) -> str:
    row_px = tables.figure(alignment, "row_offset_px")
    if row_px is None:
        return ""
    row_px = round(row_px, 2) + 0.0  # not -0.00
    if abs(row_px) <= MAX_ROW_OFFSET_PX:
        return f"Left and right agree in their rows ({row_px:+.2f} px): the rig fits these images."
    return (
        f"Left and right are {row_px:+.2f} px apart in their rows, more than {MAX_ROW_OFFSET_PX:g} px: the rig does "
        "not fit these images well; the right image was moved, but calibrating anew would be better."
    )


def _disparities(alignment: Mapping[str, Any]) -> str:
    offset_px, bow_px = (tables.figure(alignment, key) or 0.0 for key in ("offset_px", "bow_px"))
    source = alignment.get("source") or "an unknown source"
    if not offset_px and not bow_px:
        return f"The disparities' own error: {source}."
    way = "too small" if offset_px > 0 else "too large"
    bow = f", and by {abs(bow_px):.2f} px {'less' if bow_px < 0 else 'more'} at the side edges" if bow_px else ""
    done = "corrected" if alignment.get("is_applied") else "too little to be sure of, so they are taken as they are"
    return f"Disparities read {abs(offset_px):.2f} px {way}{bow}, as told by {source}: {done}."


def _effect(alignment: Mapping[str, Any], summary: Summary) -> str:
    """What doubt is left, in metres."""
    residual_px = tables.figure(alignment, "residual_px")
    focal_px, baseline_m = tables.figure(summary, "focal_px"), tables.figure(summary, "baseline_m")
    if residual_px is None:
        return ""
    doubt = f"A doubt of {residual_px:.2f} px is left"
    if not focal_px or not baseline_m:
        return f"{doubt}; it is part of every sigma."
    far_m = _FAR_M**2 * residual_px / (focal_px * baseline_m)
    return f"{doubt}, which is {far_m:.2f} m at {_FAR_M:.0f} m; it is part of every sigma."


def sigma_words(summary: Summary) -> list[str]:
    """Whether each method's sigma is honest, in one sentence per method that was measured against a truth.

    Right is what is off by less than a tenth, or than two standard deviations of a share of so few errors.
    """
    found = []
    for name, row in (summary.get("methods") or {}).items():
        share = tables.figure(row, "within_1_sigma")
        if share is not None:
            n = tables.figure(row, "n")
            off = share - tables.WITHIN_1_SIGMA
            n_at_least = math.inf if n is None else max(n, 1.0)
            right = max(0.1, 2 * math.sqrt(tables.WITHIN_1_SIGMA * (1 - tables.WITHIN_1_SIGMA) / n_at_least))
            word = "about right" if abs(off) < right else ("too wide" if off > 0 else "too narrow")
            of = "its errors" if n is None else f"its {n:.0f} errors"
            found.append(f"{name}: {word} ({100 * share:.0f} % of {of} within one sigma, 68 % expected)")
    return found


def settings_groups(summary: Summary) -> Iterator[dict[str, Any]]:
    """What is needed to repeat the run, as rows of dotted names and values."""
    for key, name in SETTINGS_GROUPS.items():
        rows = list(flattened(summary.get(key) or {}))
        if rows:
            yield {"name": name, "rows": rows}


def flattened(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Leaves of nested mappings as (dotted name, text)."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from flattened(value, f"{prefix}{key}.")
        elif isinstance(value, list | tuple):
            yield f"{prefix}{key}", ", ".join(map(str, value))
        else:
            yield f"{prefix}{key}", tables.NOTHING if value is None else str(value)
