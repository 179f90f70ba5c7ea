"""WarningSettings: horizon and thresholds of the collision warning."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class WarningSettings:
    """Settings of the collision warning; thresholds are tuned on simulated drives, seeds 0 to 99.

    Attributes:
        horizon_s: a contact within this time counts.
        on_probability: an alarm starts when the probability of contact is at least this for `min_on_s`.
        off_probability: an alarm ends when the probability has been below this for `min_off_s`.
        min_on_s: shortest time above `on_probability` before an alarm.
        min_off_s: shortest time below `off_probability` before the end of an alarm.
        min_closing_mps: smallest closing speed of an alarm.
        min_track_s: shortest time for which a track has been known.
    """

    horizon_s: float = 3.0
    on_probability: float = 0.5
    off_probability: float = 0.25
    min_on_s: float = 0.2
    min_off_s: float = 0.5
    min_closing_mps: float = 1.5
    min_track_s: float = 0.5
