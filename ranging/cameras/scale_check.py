"""ScaleCheck: the posterior of the cameras over a drive, and whether it contradicts what was given.

One hypothesis is that all priors hold; in each other hypothesis, one given value is a mistake and
has no prior. The scale is in doubt if such a hypothesis fits better by `_DOUBTFUL`, the 3 sigma of
one free parameter; all hypotheses that fit nearly as well are named, weighed by how common such a
mistake is (`prior_cost`).
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from track_range.ranging.cameras.causes import SHOWN_SIGMA, Agreement, ScaleDoubt, prior_cost
from track_range.ranging.cameras.evidence import Evidence, EvidenceSource, SeenFrame
from track_range.ranging.cameras.posterior import FREE_SIGMA, CameraPosterior, posterior
from track_range.ranging.cameras.scale_evidence import LaneEvidence, SizeEvidence, SpeedEvidence
from track_range.ranging.cameras.shape_evidence import ShapeEvidence
from track_range.ranging.cameras.unknowns import USUAL_HEIGHT_M, CameraPriors, Unknown
from track_range.ranging.measurement.rig_scale import CALIBRATED, UNKNOWN_SCALE, RigScale
from track_range.ranging.methods.lane_width import LaneWidth
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.size_model import SizeModel
from track_range.stereo.geometry.camera import PinholeCamera

_KNOWN_FOCAL = 0.05  # largest sigma of a focal length that was not itself estimated from shapes
_DOUBTFUL, _RESOLVED = 9.0, 4.0  # differences of chi-squared at which a doubt starts and ends
_NEARLY = 4.0  # largest difference between causes that both fit
# what lengths by a pair and its baseline depend on
_RIG_LENGTHS, _RIG = {Unknown.BASELINE: 1.0, Unknown.FOCAL: 1.0}, {Unknown.BASELINE: 1.0}
_MAX_RIG_SIGMA = 0.2  # of one of them, at which distances by size are better
_INTERVAL_S = 0.5  # between two evaluations
_MAX_SPANS = 600  # largest number of former doubts that are kept
_EFFECT = (
    "Until the doubt is resolved, the sigmas of affected distances cover both scales, and no alarm "
    "is given."
)


class _Mistake(NamedTuple):
    """The hypothesis that one given value is a mistake."""

    unknown: Unknown
    factor: float  # by which the value is too large
    sigma: float
    posterior: CameraPosterior
    cost: float  # chi-squared and the prior of the mistake

    @property
    def chi2(self) -> float:
        """Chi-squared of the evidence."""
        return self.posterior.chi2


class ScaleCheck:
    """All evidence of a drive; the state belongs to the instance."""

    def __init__(
        self,
        camera: PinholeCamera,
        priors: CameraPriors,
        *,
        lane: LaneWidth | None = None,
        sizes: SizeModel | None = None,
        road_height_m: float = USUAL_HEIGHT_M,
    ) -> None:
        """Start without evidence, for the (left) camera with what is known of it.

        `road_height_m` is the height with which the motion of the road is measured; `sizes` have
        the shapes of vehicles, which measure a focal length that is well known. Without the usual
        width of the lane, lane lines are not used.
        """
        self.priors = priors
        height_m = priors[Unknown.HEIGHT].value
        min_frames = {} if self._is_calibrated else {"min_frames": 1}
        self._sizes = SizeEvidence(camera, height_m, **min_frames)
        self._speeds = SpeedEvidence(height_m, road_height_m)
        sources: list[EvidenceSource] = [self._sizes, self._speeds]
        if lane is not None:
            sources.append(LaneEvidence(camera, lane, height_m))
        if isinstance(sizes, CuboidSizes) and priors[Unknown.FOCAL].sigma <= _KNOWN_FOCAL:
            sources.append(ShapeEvidence(camera, sizes))
        self._sources = sources
        self._due_s = self._since_s = -math.inf
        # starts and ends of former doubts
        self._past_s: deque[tuple[float, float]] = deque(maxlen=_MAX_SPANS)
        self.doubt: ScaleDoubt | None = None  # the latest finding; None = no contradiction
        self.agreement = Agreement(1.0, math.inf, "")
        self._posterior: CameraPosterior | None = None  # the latest; None = without evidence

    @property
    def baseline_m(self) -> float | None:
        """The given baseline; None = one camera."""
        rig = self.priors.get(Unknown.BASELINE)
        return None if rig is None else rig.value

    @property
    def _is_calibrated(self) -> bool:
        """Whether no scale has to be estimated: that of a pair is given, or there is one camera."""
        rig = self.priors.get(Unknown.BASELINE)
        return rig is None or rig.kind == "given"

    @property
    def rig_scale(self) -> RigScale:
        """The scale of a pair, as far as it has to be estimated from the drive."""
        if self._is_calibrated:
            return CALIBRATED
        known = self._posterior
        if known is None:
            return UNKNOWN_SCALE
        # the distances by size, with which others are fused, have the error of the focal length too
        if min(known.sigma_of(_RIG_LENGTHS), known.sigma_of(_RIG)) > _MAX_RIG_SIGMA:
            return UNKNOWN_SCALE
        return RigScale(known.correction(_RIG_LENGTHS), known.sigma_of(_RIG_LENGTHS))

    def update(self, seen: SeenFrame) -> ScaleDoubt | None:
        """The contradiction after a frame, None = none was found."""
        for source in self._sources:
            source.add(seen)
        if seen.time_s >= self._due_s or not self.rig_scale.is_known:
            self._due_s = seen.time_s + _INTERVAL_S
            self._evaluate(seen.time_s)
        return self.doubt

    @property
    def sentence(self) -> str:
        """What the drive shows about the baseline, or about a doubt."""
        if self.doubt is None:
            return self.agreement.sentence
        return self.doubt.sentence(self.baseline_m)

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        spans = ", ".join(f"{start:.1f} to {end:.1f} s" for start, end in self._past_s)
        past = (
            (
                f"The scale was in doubt from {spans}: during this time, sigmas are wider and no "
                "alarms are given.",
            )
            if spans
            else ()
        )
        learnt = self._learnt
        if learnt:
            past = (
                *past,
                f"Uncalibrated pair: with a focal length of {learnt['focal_px']:.0f} px, the drive "
                f"shows a baseline of {learnt['baseline_m']:.2f} m, by {self._evidence_names}; all "
                "distances share a scale uncertainty of about "
                f"{100 * learnt['relative_sigma']:.0f} %.",
            )
        if self.doubt is not None:
            return (*past, f"{self.sentence} {_EFFECT}")
        is_checked = self.baseline_m is not None and self._is_calibrated
        return (*past, self.sentence) if is_checked else past

    @property
    def _learnt(self) -> dict[str, Any]:
        """The estimated scale of a pair; empty = it is given, or not known yet."""
        scale = self.rig_scale
        if self._is_calibrated or not scale.is_known:
            return {}
        return {
            "focal_px": self.priors[Unknown.FOCAL].value,
            "baseline_m": self.priors[Unknown.BASELINE].value * scale.factor,
            "relative_sigma": scale.sigma,
            "n_tracks": self._sizes.n_objects,
        }

    def summary(self) -> dict[str, Any]:
        """Sections of summary.json."""
        sections: dict[str, Any] = {}
        if self.doubt is not None:
            sections["scale_doubt"] = {**self.doubt._asdict(), "causes": dict(self.doubt.causes)}
        if learnt := self._learnt:
            sections["learnt_scale"] = learnt
        elif self.baseline_m is not None and self._is_calibrated:
            _, sigma, evidence = self.agreement
            sections["baseline_check"] = {
                "sigma": sigma if sigma <= SHOWN_SIGMA else None,
                "evidence": evidence,
            }
        return sections

    def _evaluate(self, time_s: float) -> None:
        before, self.doubt = self.doubt, self._evaluated()
        if before is None and self.doubt is not None:
            self._since_s = time_s
        elif before is not None and self.doubt is None:
            self._past_s.append((self._since_s, time_s))

    def _evaluated(self) -> ScaleDoubt | None:
        evidence = [item for source in self._sources for item in source.evidence]
        bounds = self._speeds.bounds
        if not evidence and not bounds:
            return None
        self._evidence_names = names = self._names(evidence)
        self._posterior = right = posterior(self.priors, evidence, bounds=bounds)
        mistakes = [
            self._mistake(unknown, evidence, bounds)
            for unknown, prior in self.priors.items()
            if prior.kind == "given"
            and unknown is not Unknown.SIZES
            and any(unknown in item.of for item in (*evidence, *bounds))
        ]
        for mistake in mistakes:
            if mistake.unknown is Unknown.BASELINE:
                self.agreement = Agreement(mistake.factor, mistake.sigma, names)
        limit = _DOUBTFUL if self.doubt is None else _RESOLVED
        if right.chi2 - min((mistake.chi2 for mistake in mistakes), default=math.inf) < limit:
            return None
        best = min(mistakes, key=lambda mistake: mistake.cost)
        self._posterior = best.posterior
        near = [mistake for mistake in mistakes if mistake.cost < best.cost + _NEARLY]
        near.sort(key=lambda mistake: mistake.cost)
        causes = tuple((mistake.unknown, mistake.factor) for mistake in near)
        return ScaleDoubt(best.factor, best.sigma, self._sizes.n_objects, causes, names)

    def _mistake(
        self, unknown: Unknown, evidence: Sequence[Evidence], bounds: Sequence[Evidence]
    ) -> _Mistake:
        """The hypothesis that a given value is a mistake."""
        mistaken = {**self.priors, unknown: replace(self.priors[unknown], sigma=FREE_SIGMA)}
        wrong = posterior(mistaken, evidence, bounds=bounds)
        log_factor, sigma = wrong.estimate(unknown)
        # a height that is too large makes the camera seem lower
        factor = math.exp(-log_factor if unknown is Unknown.HEIGHT else log_factor)
        cost = wrong.chi2 + prior_cost(unknown, factor, sigma)
        return _Mistake(unknown, factor, sigma, wrong, cost)

    def _names(self, evidence: Sequence[Evidence]) -> str:
        is_given = self.priors[Unknown.HEIGHT].kind == "given"
        height = f"{'the given' if is_given else 'a usual'} height of the camera"
        *first, last = dict.fromkeys((*(item.name for item in evidence), height))
        return f"{', '.join(first)} and {last}" if first else last
