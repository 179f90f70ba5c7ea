"""ScaleDoubt: a given value that the drive contradicts, as values and as a sentence."""

import math
from typing import NamedTuple

from track_range.ranging.cameras.unknowns import MISTAKES, Unknown

SHOWN_SIGMA = 0.25  # largest standard deviation of a given value that counts as checked
_CONTRARY = 1.5  # deviation from the drive's value, in standard deviations, that is a note


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

    def sentence(self, baseline_m: float | None, focal_px: float | None = None) -> str:
        """The value in doubt, with the mistakes that fit, and the evidence; None = not given."""
        given = {Unknown.BASELINE: (baseline_m, "m"), Unknown.FOCAL: (focal_px, "px")}
        doubts = "; or ".join(
            self._cause(cause, factor, *given.get(cause, (None, "")))
            for cause, factor in self.causes
        )
        return f"Scale in doubt: {doubts}. Evidence: {self.evidence}. Check the doubtful value."

    def _cause(self, cause: Unknown, factor: float, given: float | None, unit: str) -> str:
        times = f"{factor:.2f} times (± {100 * self.sigma:.0f} %) what the drive shows"
        fits = [
            text
            for value, text in MISTAKES.get(cause, ())
            if abs(math.log(value / factor)) < 2 * self.sigma
        ]
        if given is not None:
            times += f", {given / factor:.3g} {unit} instead of {given:.3g} {unit}"
        if cause is Unknown.BASELINE and given is not None:
            fits.append(f"squares of the calibration board entered {factor:.2g} times too large")
        return f"the {cause} is {times}" + (f" ({', '.join(fits)}?)" if fits else "")


class Agreement(NamedTuple):
    """Evidence of a drive about a given value, as the baseline."""

    factor: float  # of the given value and that of the drive
    sigma: float  # relative standard deviation of the drive's
    evidence: str
    sigma_of_distances: float  # relative, with what the drive shows
    of: Unknown = Unknown.BASELINE
    given_sigma: float = 0.0  # relative standard deviation of the given value, if it is right

    @property
    def is_contrary(self) -> bool:
        """Whether the drive shows another value, though perhaps by chance."""
        sigma = math.hypot(self.sigma, self.given_sigma)
        return self.sigma <= SHOWN_SIGMA and abs(math.log(self.factor)) > _CONTRARY * sigma

    @property
    def sentence(self) -> str:
        """Note for the user on whether the drive confirms the value."""
        if self.sigma > SHOWN_SIGMA:
            return f"The {self.of} cannot be checked in this drive."
        if self.is_contrary:
            return (
                f"The {self.of} is {self.factor:.2f} ± {self.factor * self.sigma:.2f} times what "
                f"the drive shows, by {self.evidence}: no contradiction yet; the sigmas of "
                f"distances contain ± {100 * self.sigma_of_distances:.0f} % for it."
            )
        return (
            f"The {self.of} agrees with the drive within {100 * self.sigma:.0f} % (1 sigma). "
            f"Evidence: {self.evidence}."
        )
