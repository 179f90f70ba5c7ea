"""The reason of an event in one sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping

from track_range.results.events.event import EventKind

Values = Mapping[str, float]


def reason(
    kind: EventKind, class_name: str, first: Values, peak: Values, extremes: Values, *, duration_s: float
) -> str:
    """What happened, in one sentence without line breaks.

    Args:
        kind: kind of the event.
        class_name: class of the object.
        first: values of its first frame.
        peak: values of its most critical frame.
        extremes: least distances and times, largest speeds.
        duration_s: its length.
    """
    name = class_name[:1].upper() + class_name[1:]
    if kind in ("forward_collision", "pedestrian_on_path"):
        where = "on the path" if kind == "pedestrian_on_path" else "ahead"
        when = f": contact in {first['ttc_s']:.1f} s without braking" if math.isfinite(first["ttc_s"]) else ""
        return f"{name} {where} at {first['distance_m']:.0f} m{_closing(first)}{when}."
    if kind == "cut_in":
        headway = f", at a headway of {peak['headway_s']:.1f} s" if math.isfinite(peak["headway_s"]) else ""
        return f"{name} cut in {peak['distance_m']:.0f} m ahead{headway}{_closing(peak)}."
    if kind == "close_following":
        return (
            f"Headway down to {extremes['headway_s']:.1f} s behind a {class_name} at {3.6 * peak['ego_mps']:.0f} km/h "
            f"for {duration_s:.0f} s."
        )
    if kind == "hard_approach":
        needed_mps2 = peak["closing_mps"] ** 2 / (2 * max(peak["gap_m"], 0.1))
        return f"{name} ahead at {peak['distance_m']:.0f} m{_closing(peak)}: needed braking at {needed_mps2:.1f} m/s²."
    return f"{name} at {peak['distance_m']:.0f} m: contact was {extremes['ttc_s']:.1f} s away and did not happen."


def _closing(values: Values) -> str:
    closing_mps = values["closing_mps"]
    return f", closing at {closing_mps:.1f} m/s" if closing_mps > 0.5 else ""  # False for NaN
