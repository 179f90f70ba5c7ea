"""LearntFocal: an unknown focal length as a drive shows it so far, with its leading evidence."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from track_range.ranging.cameras.evidence import Evidence
from track_range.ranging.cameras.posterior import CameraPosterior, posterior
from track_range.ranging.cameras.unknowns import OF_FOCAL, CameraPriors, Unknown
from track_range.ranging.measurement.focal_scale import EXACT, FocalScale
from track_range.stereo.geometry.focal_guess import FocalGuess

_BETTER = 0.9  # largest sigma of an estimate, relative to that before the drive


@dataclass(frozen=True, slots=True)
class FocalEstimate(FocalGuess):
    """A focal length that was not given: `focal_px` in px of the rectified images, its relative
    standard deviation `sigma`, and the `source` that determines it most.
    """

    since_s: float = 0.0  # time from which on distances have it

    @property
    def sentence(self) -> str:
        """The estimate, how well it is known, from what, and from when on it is used."""
        minutes, seconds = divmod(round(self.since_s), 60)
        start = f", in use from {minutes}:{seconds:02} on" if self.since_s else ""
        return f"{self.text}{start}."

    def summary(self) -> dict[str, Any]:
        """Entry `learnt_focal` of summary.json."""
        return {
            "focal_px": round(self.focal_px, 2),
            "focal_sigma": round(self.sigma, 5),
            "source": self.source,
            "since_s": self.since_s,
        }


class LearntFocal:
    """The estimate of one drive, from its posterior; the state belongs to the instance."""

    def __init__(self, priors: CameraPriors) -> None:
        """Start with the focal length before the drive."""
        self._before = priors[Unknown.FOCAL]
        self.scale = EXACT
        self.estimate: FocalEstimate | None = None  # None = that before the drive

    def update(
        self,
        priors: CameraPriors,
        evidence: Sequence[Evidence],
        cameras: CameraPosterior,
        time_s: float,
    ) -> None:
        """Use the posterior of all evidence so far."""
        self.scale = FocalScale(cameras.correction(OF_FOCAL))
        sigma = cameras.sigma_of(OF_FOCAL, self.scale.log_factor)
        named = [item for item in evidence if Unknown.FOCAL in item.of]
        if not named or sigma > _BETTER * self._before.sigma:
            return

        def sigma_without(item: Evidence) -> float:
            others = posterior(priors, [other for other in evidence if other is not item])
            return others.estimate(OF_FOCAL).sigma

        source, since_s = max(named, key=sigma_without).name, time_s
        if self.estimate is not None and self.estimate.source == source:
            since_s = self.estimate.since_s
        focal_px = self._before.value * self.scale.factor
        self.estimate = FocalEstimate(focal_px, sigma, source, since_s)
