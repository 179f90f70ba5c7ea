"""Sentences of the report, made from a run's summary and rows: name, main results, calibration and
alignment, settings.

A disparity error e in pixels changes the distance Z = f B / d by about Z^2 e / (f B).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeGuard
from urllib.parse import quote

import numpy as np

from track_range.foundation.files.input_files import counted
from track_range.results.events.event import Event, probability_words
from track_range.results.rows.rows import Rows
from track_range.results.rows.supported import MAX_RELATIVE_SIGMA
from track_range.stereo.geometry.alignment import MAX_ROW_OFFSET_PX
from track_range.views import tables
from track_range.views.report.content.events import (
    kind_counts,
    kind_words,
    moment_words,
    object_words,
    sigma_words,
    time_words,
)
from track_range.views.tables import Summary

_FAR_M = 50.0  # distance in metres at which the effect of the remaining disparity error is given
# smallest probability of contact of a headline, as of the amber marks in the overlay
_MIN_PROBABILITY = 0.25
_LIKELY = 0.5  # probability of an event from which on it is a contact that was predicted


def run_name(summary: Summary) -> str:
    """Name of a run: the names of its videos, each with its folder; of several files, the first and
    their number.
    """
    inputs = summary.get("inputs") or {}
    names = []
    for key in ("left", "right", "video", "mono"):
        if inputs.get(key):
            files = inputs[key] if isinstance(inputs[key], list) else [inputs[key]]
            name = "/".join(Path(str(files[0])).parts[-2:])
            names.append(name if len(files) == 1 else f"{name} and {len(files) - 1} more")
    return " + ".join(names) or "A run"


def address(path: str) -> str:
    """A relative path as a URL; bytes of a file name that are not text are percent-encoded."""
    return quote(path, errors="surrogateescape")


def headlines(
    rows: Rows,
    users: Sequence[Mapping[str, Any]],
    events: Sequence[Event] | None,
    visibility: Mapping[str, Any] | None = None,
) -> list[dict[str, Any]]:
    """The three main results of a run: `figure`, `words`, and `time_s` of the moment in the video,
    if any.

    `users` are `closest_approaches` of the rows; `events` None = unknown; `visibility` is the
    section of the summary: a run that could not see says that in place of what it did not find.
    """
    first = (
        _user_headline(users) if events is None else event_headline(events, len(users), visibility)
    )
    # a contact that was warned of and is too short for a supported time: another road user's
    # longer time is then not the shortest one
    is_hidden = any(
        event.probability >= _LIKELY and np.isfinite(event.warning_s) and np.isnan(event.min_ttc_s)
        for event in events or ()
    )
    timed = [] if is_hidden else [user for user in users if user["min_ttc_front_s"] is not None]
    collision = _shortest_headline(timed) or _probability_headline(rows, users, visibility)
    return [first, _nearest_headline(users), collision]


def _headline(figure: str, words: str, time_s: float | None = None) -> dict[str, Any]:
    return {
        "figure": figure,
        "words": words,
        "time_s": None if time_s is None else round(time_s, 3),
    }


def _user_moment(user: Mapping[str, Any], key: str, figure: str, words: str) -> dict[str, Any]:
    time_s = user[f"{key}_at_s"]
    return _headline(
        figure, f"{words}: {user['class']} {user['track_id']}, {moment_words(time_s)}", time_s
    )


def event_headline(
    events: Sequence[Event], n_users: int, visibility: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The headline of the warnings or, without a warning, of the events of `n_users` road users;
    without events, first of a low `visibility`.
    """
    if not events and _is_low(visibility):
        return _headline("Low visibility", visibility["sentence"].rstrip("."))
    if not events and not n_users:
        return _headline("No road user", "was found, so that there was nothing to warn of")
    if not events:
        return _headline(
            "No event",
            "found among the road users that were measured: no collision warning, close following, "
            "hard approach, cut-in or near miss",
        )
    warnings = sorted(
        (event for event in events if np.isfinite(event.warning_s)),
        key=lambda event: event.warning_s,
    )
    n_events = counted(len(events), "event")
    if not warnings:
        if len(events) > 1:
            return _headline(n_events, f"{', '.join(kind_counts(events))}, without a warning")
        what, start_s = (
            f"{kind_words(events[0].kind)}, {object_words(events[0])}",
            events[0].start_s,
        )
        text = f"{what}, {moment_words(start_s)}, without a warning"
        return _headline(n_events, text, start_s)
    first, n = warnings[0], len(warnings)
    text = f"{object_words(first)}, {moment_words(first.warning_s)}"
    text = text if n == 1 else f"the first for {text}"
    return _headline(
        counted(n, "warning"),
        text if len(events) == n else f"{text}; {n_events} in all",
        first.warning_s,
    )


def _is_low(visibility: Mapping[str, Any] | None) -> TypeGuard[Mapping[str, Any]]:
    return bool(visibility and visibility.get("is_low") and visibility.get("sentence"))


def _user_headline(users: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Number of road users by class, for runs without events."""
    if not users:
        return _headline("No road user", "no track was confirmed in this run")
    counts = sorted(Counter(user["class"] for user in users).items())
    text = ", ".join(f"{n} \N{MULTIPLICATION SIGN} {name}" for name, n in counts)
    return _headline(counted(len(users), "road user"), f"tracked: {text}")


def _nearest_headline(users: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    if not users:
        return _headline("No distance", "no distance to a road user was measured")
    if users[0]["min_distance_m"] is None:
        within = f"{100 * MAX_RELATIVE_SIGMA:.0f} %"
        return _headline("No distance", f"is known within {within} in several frames in a row")
    sigma_m = users[0]["min_distance_sigma_m"]
    uncertainty = "" if sigma_m is None else f" (±{sigma_words(sigma_m)} m)"
    figure, words = (
        f"{users[0]['min_distance_m']:.1f} m",
        f"smallest distance from the camera{uncertainty}",
    )
    return _user_moment(users[0], "min_distance_m", figure, words)


def _shortest_headline(timed: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Shortest time to collision of road users that have one; None = none has."""
    if not timed:
        return None
    user = min(timed, key=lambda one: one["min_ttc_front_s"])
    words = "shortest time to collision with the front of the ego vehicle"
    return _user_moment(user, "min_ttc_front_s", f"{user['min_ttc_front_s']:.1f} s", words)


def _probability_headline(
    rows: Rows, users: Sequence[Mapping[str, Any]], visibility: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Largest probability of contact."""
    is_user = np.isin(rows["track_id"], [user["track_id"] for user in users])
    probability = np.where(is_user, rows["contact_probability"], np.nan)
    row = int(np.nanargmax(probability)) if np.isfinite(probability).any() else -1
    if _is_low(visibility) and not (row >= 0 and probability[row] >= _MIN_PROBABILITY):
        return _headline("Not known", "how near a collision was: the images show too little")
    if row < 0:
        return _headline("Not known", "no probability of contact could be estimated")
    if probability[row] < _MIN_PROBABILITY:
        limit = f"Below {100 * _MIN_PROBABILITY:.0f} %"
        return _headline(limit, "probability of contact of every road user where it was known")
    time_s, name = float(rows["time_s"][row]), f"{rows['class'][row]} {rows['track_id'][row]}"
    words = f"largest probability of contact: {name}, {moment_words(time_s)}"
    return _headline(probability_words(float(probability[row])), words, time_s)


def run_line(summary: Mapping[str, Any], n: int, duration_s: float) -> str:
    """Duration, frames and number n of road users of a run in one line."""
    frames = tables.figure(summary, "frames")
    parts = [
        f"{time_words(duration_s)} of video" if duration_s > 0 else "",
        counted(int(frames), "frame") if frames is not None else "",
        counted(n, "road user"),
    ]
    return ", ".join(part for part in parts if part)


def card(name: str, value: object, detail: str) -> dict[str, str]:
    """One card; a value that is None was not measured."""
    return {
        "name": name,
        "value": tables.NOTHING if value is None else str(value),
        "detail": detail,
    }


def geometry_sentences(summary: Summary) -> list[str]:
    """Sentences about the calibration and the alignment of the two cameras."""
    rig = (summary.get("inputs") or {}).get("rig")
    calibrations = {
        "rig": f"Calibrated: {rig or 'calibration file in the folder of the video'}.",
        "focal length": "The focal length was given by the user; lens distortion is not corrected.",
        "estimated": "Uncalibrated: the scale is estimated from the drive; distances are "
        "approximate.",
    }
    sentences = [calibrations.get(str(summary.get("calibration")), "")]
    if estimate := summary.get("camera_estimate"):
        sentences[0] = (
            "Not calibrated: the focal length was estimated from the recording as "
            f"{estimate['focal_px']:,.0f} px within {100 * estimate['focal_sigma']:.1f} %."
        )
        if estimate.get("is_distortion_corrected"):
            sentences.append(f"A distortion of k1 = {estimate['k1']:+.3f} was corrected.")
    elif learnt := summary.get("learnt_focal"):
        sentences[0] = (
            "Not calibrated: the focal length was estimated during the run as "
            f"{learnt['focal_px']:,.0f} px within {100 * learnt['focal_sigma']:.1f} %, from "
            f"{learnt['source']}; distances have it from {learnt['since_s']:.1f} s on."
        )
    if scale := summary.get("learnt_scale"):
        sentences.append(
            "The baseline was estimated from the drive, with "
            f"{counted(scale['n_tracks'], 'track')}: {scale['baseline_m']:.2f} m at a focal length "
            f"of {scale['focal_px']:.0f} px; all distances share a relative error of "
            f"{100 * scale['relative_sigma']:.0f} % (1 {tables.SIGMA})."
        )
    alignment = summary.get("alignment")
    if alignment:
        sentences += [
            _vertical_offset(alignment),
            _disparities(alignment),
            _residual(alignment, summary),
        ]
        health = alignment.get("health") or {}
        sentences += [health.get(key) or "" for key in ("sentence", "move_sentence", "unseen")]
    return [sentence for sentence in sentences if sentence]


def _vertical_offset(alignment: Mapping[str, Any]) -> str:
    offset_px = tables.figure(alignment, "row_offset_px")
    if offset_px is None:
        return ""
    offset_px = round(offset_px, 2) + 0.0  # not -0.00
    sentence = f"Vertical offset between left and right {offset_px:+.2f} px"
    if abs(offset_px) <= MAX_ROW_OFFSET_PX:
        return f"{sentence}: the calibration fits these images."
    return (
        f"{sentence}, more than {MAX_ROW_OFFSET_PX:g} px: the calibration does not fit these "
        "images well; the right image was shifted, but a new calibration is recommended."
    )


def _disparities(alignment: Mapping[str, Any]) -> str:
    offset_px, curvature_px = (
        tables.figure(alignment, key) or 0.0 for key in ("offset_px", "bow_px")
    )
    source = alignment.get("source") or "unknown source"
    if not offset_px and not curvature_px:
        return f"Disparity error: {source}."
    sign = "too small" if offset_px > 0 else "too large"
    edges = ""
    if curvature_px:
        more = "less" if curvature_px < 0 else "more"
        edges = f", and {abs(curvature_px):.2f} px {more} at the left and right image edges"
    state = "corrected" if alignment.get("is_applied") else "not significant; not applied"
    return f"Disparities are {abs(offset_px):.2f} px {sign}{edges} (source: {source}; {state})."


def _residual(alignment: Mapping[str, Any], summary: Summary) -> str:
    residual_px = tables.figure(alignment, "residual_px")
    focal_px, baseline_m = tables.figure(summary, "focal_px"), tables.figure(summary, "baseline_m")
    if residual_px is None:
        return ""
    metres = ""
    if focal_px and baseline_m:
        metres = f" ({_FAR_M**2 * residual_px / (focal_px * baseline_m):.2f} m at {_FAR_M:.0f} m)"
    return (
        f"The residual disparity uncertainty is {residual_px:.2f} px{metres}, included in every "
        "sigma."
    )


def sigma_sentences(summary: Summary) -> list[str]:
    """Calibration of each method's sigma, in one sentence per method with errors against ground
    truth.

    Sigma is about right if the fraction of errors within one sigma differs from 68 % by less than
    10 percentage points, or by less than two standard deviations of a fraction of that many errors.
    """
    sentences = []
    for name, row in (summary.get("methods") or {}).items():
        fraction = tables.figure(row, "within_1_sigma")
        if fraction is not None:
            n = tables.figure(row, "n")
            excess = fraction - tables.WITHIN_1_SIGMA
            n_errors = math.inf if n is None else max(n, 1.0)
            tolerance = max(
                0.1, 2 * math.sqrt(tables.WITHIN_1_SIGMA * (1 - tables.WITHIN_1_SIGMA) / n_errors)
            )
            verdict = (
                "about right"
                if abs(excess) < tolerance
                else ("too large" if excess > 0 else "too small")
            )
            errors = "errors" if n is None else f"{n:.0f} errors"
            sentences.append(
                f"{name}: {verdict} ({100 * fraction:.0f} % of {errors} within one "
                "sigma, expected 68 %)"
            )
    return sentences


def settings_groups(summary: Summary) -> Iterator[dict[str, Any]]:
    """Inputs, settings and versions of a run as rows of dotted names and values."""
    networks = {
        str(one.get("method")): {key: one[key] for key in one if key != "method"}
        for one in summary.get("networks") or ()
    }
    for key, of_key in (
        ("inputs", summary.get("inputs")),
        ("networks", networks),
        ("settings", summary.get("settings")),
        ("versions", summary.get("versions")),
    ):
        rows = list(flattened(of_key or {}))
        if rows:
            yield {"name": key.capitalize(), "rows": rows}


def flattened(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Leaves of nested mappings as (dotted name, text); lists are joined by commas."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from flattened(value, f"{prefix}{key}.")
        elif isinstance(value, list | tuple):
            yield f"{prefix}{key}", ", ".join(map(str, value))
        else:
            yield f"{prefix}{key}", tables.NOTHING if value is None else str(value)
