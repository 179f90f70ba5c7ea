"""ScaleDoubt: a given scale that the drive contradicts, as values and as a sentence."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from track_range.ranging.cameras.unknowns import Unknown

SHOWN_SIGMA = 0.25  # largest standard deviation of a baseline that counts as checked


class ScaleDoubt(NamedTuple):
    """A given scale that contradicts the drive."""

    factor: float  # by which the first of `causes` is too large
    sigma: float  # relative standard deviation of the factor
    n_objects: int  # road users that are evidence
    # what may be wrong, the most likely first, and the factor of each
    causes: tuple[tuple[Unknown, float], ...]
    evidence: str  # what shows it

    @property
    def cause_names(self) -> list[Unknown]:
        """What may be wrong, the most likely first."""
        return [cause for cause, _ in self.causes]

    @property
    def sigma_by_cause(self) -> dict[Unknown, float]:
        """Relative standard deviations that cover both scales, of what each cause changes."""
        return {
            cause: abs(1.0 - 1.0 / factor) + self.sigma / factor for cause, factor in self.causes
        }

    def sentence(self, baseline_m: float | None) -> str:
        """The value in doubt, with the mistakes that fit, and the evidence."""
        doubts = "; or ".join(self._cause(*cause, baseline_m) for cause in self.causes)
        return f"Scale in doubt: {doubts}. Evidence: {self.evidence}. Check the doubtful value."

    def _cause(self, cause: Unknown, factor: float, baseline_m: float | None) -> str:
        times = f"{factor:.2f} times (± {100 * self.sigma:.0f} %) what the drive shows"
        fits = known_mistakes(cause, factor, self.sigma)
        if cause is Unknown.BASELINE and baseline_m is not None:
            times += f", {baseline_m / factor:.3g} m instead of {baseline_m:.3g} m"
            fits.append(f"squares of the calibration board entered {factor:.2g} times too large")
        return f"the {cause} is {times}" + (f" ({', '.join(fits)}?)" if fits else "")


# mistakes, and the factor that each makes a value too large by
_MISTAKES: tuple[tuple[Unknown, float, str], ...] = (
    (Unknown.BASELINE, 2.54, "centimetres read as inches"),
    (Unknown.BASELINE, 1 / 2.54, "inches read as centimetres"),
    (Unknown.BASELINE, 3.281, "feet read as metres"),
    (Unknown.BASELINE, 0.3048, "metres read as feet"),
    (Unknown.BASELINE, 10.0, "millimetres read as centimetres"),
    (Unknown.BASELINE, 0.1, "centimetres read as millimetres"),
    (Unknown.FOCAL, 0.5, "the matrix of images of half the size"),
    (Unknown.FOCAL, 2.0, "the matrix of images of twice the size"),
    (Unknown.SPEED, 3.6, "km/h read as m/s"),
    (Unknown.SPEED, 1 / 3.6, "m/s read as km/h"),
    (Unknown.SPEED, 1.609, "km/h read as miles per hour"),
    (Unknown.SPEED, 1 / 1.609, "miles per hour read as km/h"),
    (Unknown.SPEED, 1.944, "knots read as m/s"),
    (Unknown.SPEED, 1 / 1.852, "knots read as km/h"),
)


def known_mistakes(cause: Unknown, factor: float, sigma: float) -> list[str]:
    """Known mistakes with this factor, within 2 sigma."""
    return [
        text
        for of, value, text in _MISTAKES
        if of == cause and abs(math.log(value / factor)) < 2 * sigma
    ]


def prior_cost(cause: Unknown, factor: float, sigma: float) -> float:
    """-2 log of the prior of a mistake with this factor: known, or else with a uniform density of
    the logarithm.

    Baselines may have any factor at no cost: boards have squares of all sizes.
    """
    any_factor = (
        0.0
        if cause is Unknown.BASELINE
        else max(0.0, -2 * math.log(math.sqrt(2 * math.pi) * sigma))
    )
    return min(
        [
            any_factor,
            *((math.log(value / factor) / sigma) ** 2 for of, value, _ in _MISTAKES if of == cause),
        ]
    )


def causes_of(error_sources: Sequence[str], *, has_rig: bool) -> frozenset[Unknown]:
    """The given values that affect the distances of a method with these error sources."""
    causes: set[Unknown] = {Unknown.FOCAL}
    if "baseline" in error_sources:
        causes.add(Unknown.BASELINE)
    # by a height or a width that speed, height or stereo measured
    if {"horizon", "lane_width"} & {*error_sources}:
        causes |= {Unknown.HEIGHT, Unknown.SPEED}
        if has_rig:
            causes.add(Unknown.BASELINE)
    return frozenset(causes)


class Agreement(NamedTuple):
    """Evidence of a drive about the baseline."""

    factor: float  # of the given baseline and that of the drive
    sigma: float  # relative standard deviation of the drive's
    evidence: str

    @property
    def sentence(self) -> str:
        """Note for the user on whether the drive confirms the baseline."""
        if self.sigma > SHOWN_SIGMA:
            return "The baseline cannot be checked in this drive."
        if abs(math.log(self.factor)) > 1.5 * self.sigma:
            return (
                f"The baseline is {self.factor:.2f} ± {self.factor * self.sigma:.2f} times what "
                f"the drive shows, by {self.evidence}: no contradiction yet."
            )
        return (
            f"The baseline agrees with the drive within {100 * self.sigma:.0f} % (1 sigma), by "
            f"{self.evidence}."
        )
