"""ScaleCheck: the posterior of the cameras over a drive, and whether it contradicts what was given.

The scale is in doubt if it is more probable that a given value is a mistake than that all are
right; all mistakes that are nearly as probable as the most likely one are named. Only sentences and
alarms have this threshold: sigmas follow the probabilities (`CameraPosterior.sigma_of`).
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from track_range.foundation.background import Background
from track_range.foundation.errors import Note
from track_range.ranging.cameras.causes import SHOWN_SIGMA, Agreement, ScaleDoubt
from track_range.ranging.cameras.evidence import Evidence, EvidenceSource, SeenFrame
from track_range.ranging.cameras.known_distances import KnownDistances
from track_range.ranging.cameras.learnt_focal import FocalEstimate, LearntFocal
from track_range.ranging.cameras.motion_evidence import MotionEvidence
from track_range.ranging.cameras.network_evidence import NetworkEvidence
from track_range.ranging.cameras.posterior import CameraPosterior, posterior
from track_range.ranging.cameras.scale_evidence import (
    HIGHEST,
    LaneEvidence,
    SizeEvidence,
    SpeedEvidence,
)
from track_range.ranging.cameras.shape_evidence import ShapeEvidence
from track_range.ranging.cameras.unknowns import (
    FREE_SIGMA,
    OF_BASELINE,
    OF_PAIR,
    USUAL_HEIGHT_M,
    AnyUnknown,
    CameraPriors,
    Kind,
    Prior,
    Sum,
    Unknown,
)
from track_range.ranging.measurement.focal_scale import EXACT, FocalScale
from track_range.ranging.measurement.rig_scale import (
    CALIBRATED,
    UNKNOWN_SCALE,
    DisparityOffset,
    RigScale,
)
from track_range.ranging.methods.lane_width import LaneWidth
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.network_scale import NetworkScale
from track_range.ranging.size_models.size_model import SizeModel
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

_DOUBTFUL, _RESOLVED = 2.0, 0.5  # odds of a mistake at which a doubt starts and ends
_NEARLY = 0.135  # smallest probability of a cause, over that of the most likely one
# heights by the speeds of a pair and of the road, and by a given speed and that of the road
_RIG_HEIGHT: Sum = {Unknown.HEIGHT: 1.0, Unknown.BASELINE: 1.0}
_ROAD_HEIGHT: Sum = {Unknown.HEIGHT: 1.0, Unknown.FOCAL: -1.0}
_MAX_HEIGHT_SIGMA = 0.05  # relative, of a height by a drive that is used
_MAX_RIG_SIGMA = 0.2  # of one of them, at which distances by size are better
_MIN_OFFSET_PX = 1.0  # of the disparities, of which the user is told
_INTERVAL_S = 0.5  # between two evaluations, at most
_MAX_SPANS = 600  # largest number of former doubts that are kept
_EFFECT = (
    "Until the doubt is resolved, the sigmas of affected distances cover both scales, and no alarm "
    "is given."
)


class ScaleCheck:
    """All evidence of a drive; the state belongs to the instance."""

    def __init__(
        self,
        camera: PinholeCamera,
        priors: CameraPriors,
        *,
        rig: StereoRig | None = None,
        lane: LaneWidth | None = None,
        sizes: SizeModel | None = None,
        road_height_m: float = USUAL_HEIGHT_M,
        learns_focal: bool = False,
        background: Background | None = None,
    ) -> None:
        """Start without evidence, for the (left) camera, or the rig of a pair, with what is known
        of it.

        `road_height_m` is the height with which the motion of the road is measured; `sizes` have
        the shapes of vehicles, which measure a focal length that is well known. Without the usual
        width of the lane, lane lines are not used. With `learns_focal`, an unknown focal length is
        estimated from the drive, and corrects its distances, by calls in the `background`; None =
        in threads, with waiting.
        """
        self.priors = priors
        is_unknown = priors[Unknown.FOCAL].kind == "unknown"
        self._focal = LearntFocal(priors) if learns_focal and is_unknown else None
        height_m = priors[Unknown.HEIGHT].value
        self._rig, self._road_height_m = rig, road_height_m
        self._sizes = SizeEvidence(camera, height_m, rig=rig)
        self._speeds = SpeedEvidence(height_m, road_height_m)
        sources: list[EvidenceSource] = [self._sizes, self._speeds]
        if lane is not None:
            sources.append(LaneEvidence(camera, lane, height_m))
        if self._focal is not None or priors[Unknown.FOCAL].kind == "given":
            sources.append(MotionEvidence(camera, background))
            if isinstance(sizes, CuboidSizes):
                sources.append(ShapeEvidence(camera, sizes, background))
        self._sources = sources
        self._known = KnownDistances(())
        self._networks: dict[str, NetworkEvidence] = {}
        self._evidence_names = ""  # of the latest evaluation
        self._due_s = self._since_s = -math.inf
        self._first_s = math.inf  # time of the first frame
        # starts and ends of former doubts
        self._past_s: deque[tuple[float, float]] = deque(maxlen=_MAX_SPANS)
        self.doubt: ScaleDoubt | None = None  # the latest finding; None = no contradiction
        # the priors and the evidence of the latest evaluation
        self._evaluated: tuple[CameraPriors, Sequence[Evidence]] = (priors, ())
        self.cameras: CameraPosterior = posterior(priors, [])
        # of a pair, beside that of the focal length; of lengths by the motion of the road
        self.rig_scale, self.road_scale = self._scales()

    def use(self, known: KnownDistances) -> None:
        """Take distances that the user measured into account, from the next frame on."""
        self._known = known
        self._sources.append(known)

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
    def focal_scale(self) -> FocalScale:
        """The error of the focal length, as far as it has to be estimated from the drive."""
        return EXACT if self._focal is None else self._focal.scale

    @property
    def focal(self) -> FocalEstimate | None:
        """The focal length as the drive shows it; None = it is known, or as before the drive."""
        return None if self._focal is None else self._focal.estimate

    @property
    def network_scales(self) -> dict[str, NetworkScale]:
        """The scales of depth networks, by the name of their method."""
        return {name: network.scale for name, network in self._networks.items()}

    def _scales(self) -> tuple[RigScale, RigScale]:
        """`rig_scale` and `road_scale` by the posterior."""
        rig = self._rig_scale()
        return rig, self._road_scale(rig)

    def _rig_scale(self) -> RigScale:
        """The scale of a pair, as far as it has to be estimated from the drive, beside that of the
        focal length.
        """
        offset = self._offset
        if self._is_calibrated:
            return replace(CALIBRATED, offset=offset)
        at_centre: Sum = {} if offset is None else {Unknown.OFFSET: offset.centre}
        sums = {**OF_PAIR, **at_centre}, {**OF_BASELINE, **at_centre}
        sigmas = [self.cameras.sigma_of(of, self.cameras.correction(of)) for of in sums]
        # the distances by size, with which others are fused, have the error of the focal length too
        if min(sigmas) > _MAX_RIG_SIGMA:
            return UNKNOWN_SCALE
        log_factor = self.cameras.correction(OF_PAIR) - self.focal_scale.log_factor
        return RigScale(log_factor, sigmas[0], offset)

    @property
    def _offset(self) -> DisparityOffset | None:
        """The error of the disparities, unless the alignment knows it."""
        cameras, rig = self.cameras, self._rig
        of: Sum = {Unknown.OFFSET: 1.0}
        if rig is None or Unknown.OFFSET not in cameras.unknowns:
            return None
        variance = cameras.covariance_of(of, of)
        return DisparityOffset(
            cameras.correction(of),
            cameras.error_of(of, cameras.correction(of)),
            self._sizes.residual_px,
            rig.left.fx_px * rig.baseline_m,
            centre=-cameras.covariance_of(of, OF_PAIR) / variance,
        )

    def _road_scale(self, rig: RigScale) -> RigScale:
        """The scale of lengths by the motion of the road, with which they have the scale of all
        others, as that of the `rig`; a given height needs no correction.
        """
        assumed, has_rig = self.priors[Unknown.HEIGHT], Unknown.BASELINE in self.priors
        if assumed.kind == "given":
            return CALIBRATED
        if not rig.is_known:
            return UNKNOWN_SCALE
        of = _RIG_HEIGHT if has_rig else _ROAD_HEIGHT
        mean = self.cameras.correction(of)
        of_others = rig.log_factor if has_rig else -self.focal_scale.log_factor
        log_height = math.log(assumed.value / self._road_height_m) + mean - of_others
        return RigScale(-log_height, self.cameras.sigma_of(of, mean))

    @property
    def height_m(self) -> tuple[float, float] | None:
        """Height of the camera above the road and its standard deviation, with which distances by
        the road have the scale of all others; None = it is given, or not known well.
        """
        road = self.road_scale
        if road == CALIBRATED or road.sigma > _MAX_HEIGHT_SIGMA:
            return None
        height_m = self._road_height_m * road.factor
        return height_m, road.sigma * height_m

    def update(self, seen: SeenFrame) -> bool:
        """Add a frame; True = the posterior and the doubt are new."""
        for name, network in seen.by_network.items():
            if name not in self._networks:
                self._networks[name] = NetworkEvidence(name, network.errors)
        for source in (*self._sources, *self._networks.values()):
            source.add(seen)
        if seen.time_s < self._due_s and self.rig_scale.is_known:
            return False
        self._first_s = min(self._first_s, seen.time_s)
        # at first with every frame: a clip may be short
        self._due_s = seen.time_s + min(_INTERVAL_S, seen.time_s - self._first_s)
        self._evaluate(seen.time_s)
        return True

    @property
    def sentence(self) -> str:
        """What the drive shows about the baseline, or about a doubt."""
        if self.doubt is None:
            return self.agreement.sentence
        return self.doubt.sentence(self.baseline_m, self.priors[Unknown.FOCAL].value)

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        spans = ", ".join(f"{start:.1f} to {end:.1f} s" for start, end in self._past_s)
        was_in_doubt = (
            Note(
                f"The scale was in doubt from {spans}: during this time, sigmas are wider and no "
                "alarms are given.",
                "scale-was-in-doubt",
                "ok",
                "calibration",
            ),
        )
        of_focal = () if self.focal is None else (_of_focal(self.focal),)
        past = (
            *self._known.notes,
            *of_focal,
            *self._offset_notes,
            *(note for network in self._networks.values() for note in network.notes),
            *(was_in_doubt if spans else ()),
        )
        if learnt := self._learnt:
            has_speed = any(Unknown.SPEED in item.of for item in self._speeds.evidence)
            advice = "; a given speed (GPS, --ego-speed) would show the scale within 1 to 3 %"
            past = (
                *past,
                Note(
                    f"Uncalibrated pair: with a focal length of {learnt['focal_px']:.0f} px, the drive "
                    f"shows a baseline of {learnt['baseline_m']:.2f} m, by {self._evidence_names}; all "
                    "distances share a scale uncertainty of about "
                    f"{100 * learnt['relative_sigma']:.0f} %{'' if has_speed else advice}.",
                    "baseline-estimated",
                    "ok",
                    "calibration",
                ),
            )
        if self.doubt is not None:
            return (
                *past,
                Note(f"{self.sentence} {_EFFECT}", "scale-in-doubt", "error", "calibration"),
            )
        is_height_given = self.priors[Unknown.HEIGHT].kind == "given"
        if is_height_given and self.height_agreement.is_contrary:
            past = (*past, self._height_note)
        is_checked = self.baseline_m is not None and self._is_calibrated
        return (*past, self._checked_note) if is_checked else past

    @property
    def _height_note(self) -> Note:
        sentence = self.height_agreement.sentence
        return Note(sentence, "height-contradicted", "warning", "calibration")

    @property
    def _checked_note(self) -> Note:
        return Note(self.sentence, "baseline-checked", "ok", "calibration")

    @property
    def _offset_notes(self) -> tuple[str, ...]:
        """A message on an offset of the disparities that is large and clear."""
        offset = self._offset
        if offset is None or abs(offset.px) < max(_MIN_OFFSET_PX, 2 * offset.sigma_px):
            return ()
        size = "small" if offset.px > 0 else "large"
        return (
            Note(
                f"Disparities are {abs(offset.px):.1f} ± {offset.sigma_px:.1f} px too {size}, by the "
                "sizes of near and far road users, as with shifted images or a turned camera: "
                "corrected, and part of every sigma; a drive in motion (or --align FILE) measures this "
                "better.",
                "disparity-offset",
                "warning",
                "pair",
            ),
        )

    @property
    def _learnt(self) -> dict[str, Any]:
        """The estimated scale of a pair; empty = it is given, or not known yet."""
        scale = self.rig_scale
        if self._is_calibrated or not scale.is_known:
            return {}
        return {
            "focal_px": self.priors[Unknown.FOCAL].value * self.focal_scale.factor,
            "baseline_m": self.priors[Unknown.BASELINE].value * scale.factor,
            "relative_sigma": scale.sigma,
            "n_tracks": self._sizes.n_objects,
        }

    def summary(self) -> dict[str, Any]:
        """Sections of summary.json."""
        sections: dict[str, Any] = {}
        if self.focal is not None:
            sections["learnt_focal"] = self.focal.summary()
        if self._networks:
            of_networks = {name: network.summary() for name, network in self._networks.items()}
            sections["depth_networks"] = of_networks
        if self.doubt is not None:
            sections["scale_doubt"] = {**self.doubt._asdict(), "causes": dict(self.doubt.causes)}
        if learnt := self._learnt:
            sections["learnt_scale"] = learnt
        elif self.baseline_m is not None and self._is_calibrated:
            agreement = self.agreement
            sections["baseline_check"] = {
                "sigma": agreement.sigma if agreement.sigma <= SHOWN_SIGMA else None,
                "evidence": agreement.evidence,
            }
        return sections

    def _evaluate(self, time_s: float) -> None:
        evidence = [item for source in self._sources for item in source.evidence]
        priors = dict(self.priors)
        if self._sizes.has_offset:
            kind: Kind = "given" if self._is_calibrated else "unknown"
            priors[Unknown.OFFSET] = Prior(self._sizes.residual_px, kind)
        is_height_given = priors[Unknown.HEIGHT].kind == "given"
        bounds = [*self._speeds.bounds, *([] if is_height_given else [HIGHEST])]
        self.cameras = posterior(priors, evidence, bounds=bounds)
        if self._focal is not None:
            self._focal.update(priors, evidence, self.cameras, time_s)
        self._update_networks(priors, evidence, bounds)
        self.rig_scale, self.road_scale = self._scales()
        self._evaluated = priors, evidence
        self._evidence_names = names = self._names(evidence)
        before, self.doubt = self.doubt, self._contradiction(names)
        if before is None and self.doubt is not None:
            self._since_s = time_s
        elif before is not None and self.doubt is None:
            self._past_s.append((self._since_s, time_s))

    def _update_networks(
        self,
        priors: Mapping[AnyUnknown, Prior],
        evidence: Sequence[Evidence],
        bounds: Sequence[Evidence],
    ) -> None:
        """Estimate the factors of networks beside the cameras, which they do not change: a network
        is corrected by the others, and does not count as evidence of them. One by one, since
        together their hypotheses would multiply.
        """
        for network in self._networks.values():
            known: dict[AnyUnknown, Prior] = {**priors, network.unknown: network.prior}
            network.update(posterior(known, [*evidence, *network.evidence], bounds=bounds))

    @property
    def agreement(self) -> Agreement:
        """The baseline that the drive shows by itself; unknown without a pair."""
        return self._agreement(Unknown.BASELINE, self._evidence_names)

    @property
    def height_agreement(self) -> Agreement:
        """The same of a given height of the camera."""
        _, evidence = self._evaluated
        of_height = [item.name for item in evidence if Unknown.HEIGHT in item.of]
        return self._agreement(Unknown.HEIGHT, _listed(of_height))

    def _agreement(self, of: Unknown, names: str) -> Agreement:
        """The value that the drive shows by itself, by evidence of these names."""
        priors, evidence = self._evaluated
        if of not in priors:
            return Agreement(1.0, math.inf, "", 0.0)
        unknown = replace(priors[of], sigma=FREE_SIGMA, kind="unknown")
        shown = posterior({**priors, of: unknown}, evidence).estimate({of: 1.0})
        of_distances = self.cameras.sigma_of({of: 1.0})
        return Agreement(
            math.exp(_too_large(of, shown.mean)),
            shown.sigma,
            names,
            of_distances,
            of,
            priors[of].sigma,
        )

    def _contradiction(self, names: str) -> ScaleDoubt | None:
        """What is probably a mistake, if this is more probable than that all is right.

        An offset of the disparities is corrected.
        """
        right = self.cameras.probability(None) + self.cameras.probability(Unknown.OFFSET)
        odds = {
            cause: self.cameras.probability(cause) / max(right, 1e-12)
            for cause in dict.fromkeys(self.cameras.cause)
            if cause not in (None, Unknown.OFFSET)
        }
        if sum(odds.values()) < (_DOUBTFUL if self.doubt is None else _RESOLVED):
            return None
        by_odds = sorted(odds, key=lambda cause: -odds[cause])
        near = [cause for cause in by_odds if odds[cause] > _NEARLY * odds[by_odds[0]]]
        shown = [(cause, self.cameras.estimate({cause: 1.0}, cause)) for cause in near]
        causes = tuple((cause, math.exp(_too_large(cause, of.mean))) for cause, of in shown)
        return ScaleDoubt(causes[0][1], shown[0][1].sigma, self._sizes.n_objects, causes, names)

    def _names(self, evidence: Sequence[Evidence]) -> str:
        is_given = self.priors[Unknown.HEIGHT].kind == "given"
        height = f"{'the given' if is_given else 'a usual'} height of the camera"
        return _listed([*(item.name for item in evidence), height])


def _too_large(of: Unknown, mean: float) -> float:
    """What a given value is too large by, as a logarithm: one of a height makes the camera seem
    lower.
    """
    return -mean if of is Unknown.HEIGHT else mean


def _listed(names: Sequence[str]) -> str:
    """The different names, as part of a sentence."""
    *first, last = dict.fromkeys(names) or ("",)
    return f"{', '.join(first)} and {last}" if first else last


def _of_focal(focal: FocalEstimate) -> Note:
    return Note(focal.sentence, "focal-length-estimated", "ok", "calibration")
