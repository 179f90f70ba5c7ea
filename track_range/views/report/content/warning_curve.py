"""warning_curve: false alarms per hour against lead time of the collision warning, measured on simulated drives.

The figure is the same in all reports: it shows what one camera, a stereo rig and both methods together achieve. Its
values are packaged in assets/warning_curve.json:

    {"protocol": text, "methods": {name: [[false alarms per hour, median lead in s, fraction of contacts], ...]}}

The fraction is that of the contacts with a warning at least 2.1 s before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from track_range.foundation.files.structured_text import parse_json
from track_range.pipeline.colours import colour_of_each

CURVE_FILE = "warning_curve.json"

_WIDTH_PX, _HEIGHT_PX = 640, 300
_LEFT_PX, _RIGHT_PX, _TOP_PX, _BOTTOM_PX = 44, 22, 12, 40  # size of the figure and its margins, px
_MIN_PER_HOUR = 0.1  # smallest rate of the logarithmic axis, 1/h; curves without a false alarm start there


@cache
def packaged_curve() -> Mapping[str, Any] | None:
    """Content of the packaged file; None = it has no values."""
    source = files("track_range.views.report") / "assets" / CURVE_FILE
    if not source.is_file():
        return None
    content: dict[str, Any] = parse_json(source.read_text(encoding="utf-8"), CURVE_FILE, ValueError, "the curve")
    return content if content.get("methods") else None


def curve_figure(content: Mapping[str, Any]) -> dict[str, Any]:
    """The figure for the template.

    Keys: `width`, `height`, `protocol`, `alternative` (the curves in words), `x_ticks` and `y_ticks` ({at, text}),
    `inner` (edges of the axes), and `lines` ({name, colour, path, dots}), all in px.
    """
    methods: Mapping[str, Sequence[Sequence[float | None]]] = content["methods"]
    curves = {  # points with a rate and a lead time; the fraction of contacts is 0 where it is unknown
        name: sorted(
            (float(per_hour), float(lead_s), float((rest[0] if rest else None) or 0.0))
            for per_hour, lead_s, *rest in points
            if per_hour is not None and lead_s is not None
        )
        for name, points in methods.items()
    }
    points = [point for curve in curves.values() for point in curve]
    last_decade = math.ceil(math.log10(max([1.0, *(per_hour for per_hour, _, _ in points)])))
    highest_s = max(1.0, math.ceil(1.1 * max([0.0, *(lead_s for _, lead_s, _ in points)])))
    first_decade = round(math.log10(_MIN_PER_HOUR))

    def x_px(per_hour: float) -> float:
        fraction = (math.log10(max(per_hour, _MIN_PER_HOUR)) - first_decade) / (last_decade - first_decade)
        return round(_LEFT_PX + fraction * (_WIDTH_PX - _LEFT_PX - _RIGHT_PX), 1)

    def y_px(lead_s: float) -> float:
        return round(_TOP_PX + (1 - lead_s / highest_s) * (_HEIGHT_PX - _TOP_PX - _BOTTOM_PX), 1)

    colours = colour_of_each(list(curves))
    lines, words = [], []
    for name, curve in curves.items():
        at = [(x_px(per_hour), y_px(lead_s), fraction) for per_hour, lead_s, fraction in curve]
        path = "M" + "L".join(f"{x} {y}" for x, y, _ in at) if at else ""
        dots = [{"x": x, "y": y, "r": round(1.5 + 4 * fraction, 1)} for x, y, fraction in at]
        lines.append({"name": name, "colour": colours[name], "path": path, "dots": dots})
        texts = [f"{per_hour:.1f} per hour with {lead_s:.1f} s" for per_hour, lead_s, _ in curve]
        words.append(f"{name}: {', '.join(texts) or 'no values'}")
    return {
        "width": _WIDTH_PX,
        "height": _HEIGHT_PX,
        "inner": {"left": _LEFT_PX, "right": _WIDTH_PX - _RIGHT_PX, "top": _TOP_PX, "bottom": _HEIGHT_PX - _BOTTOM_PX},
        "protocol": str(content.get("protocol", "")),
        "alternative": "; ".join(words),
        "x_ticks": [{"at": x_px(10.0**k), "text": f"{10.0**k:g}"} for k in range(first_decade, last_decade + 1)],
        "y_ticks": [{"at": y_px(value), "text": f"{value} s"} for value in range(int(highest_s) + 1)],
        "lines": lines,
    }
