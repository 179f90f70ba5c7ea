"""CameraEstimate: the focal length of one camera from all evidence of its recordings, and what
would make it better.

Each source is a likelihood L_i of the log focal length on one grid. A source may also be a mistake
(a cropped video, a tracked lorry, a wrong tape measure), with a probability e_i that depends on its
kind; it then says nothing. The posterior is the mean over both hypotheses of every source:

    p(log f)  ~  prod_i [ (1 - e_i) L_i(log f) / integral(L_i) + e_i M_i(log f) ]

with a constant M_i, or for what replaces the usual field of view of road cameras (metadata, a given
calibration) that field. The uncertainty widens with the contradiction of the sources, without a
threshold. The curve is the prior of the focal length in the posterior of the cameras
(`ranging/cameras/posterior`), in which equations with other unknowns (speed, known metres) are
sources: the curve of the focal length by them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.focal_curve import FocalCurve, log_focal_grid
from track_range.stereo.geometry.focal_guess import FocalGuess, default_guess
from track_range.stereo.lenses.pinhole import first_radial

# "given" = a calibration file with its sigma; "usual" = the field of view of most road cameras
SourceKind = Literal["given", "usual", "metadata", "shapes", "motion", "speed", "known metres"]

N_GRID = 1201  # points of the grid, 0.25 % apart
# Probability that a source is a mistake; assumed. Metadata of cropped or stabilised video is wrong
# most often. Motion checks itself, and a wrong unit of a speed is in its curve.
_MISTAKE = {
    "given": 0.01,
    "usual": 0.03,
    "metadata": 0.05,
    "shapes": 0.05,
    "motion": 0.005,
    "speed": 0.02,
    "known metres": 0.02,
}
_REPLACE_USUAL = ("given", "metadata")  # sources beside which the usual field of view is no source
_WORTHWHILE = 0.8  # largest ratio of the sigma with further evidence to that without worth a note
# smallest ratio of |k1| to its sigma, and displacement of the image's corner in px, from which on a
# distortion is corrected
_SIGNIFICANT, _VISIBLE_PX = 3.0, 1.0
_WIDE_DEG = 100.0  # field of view from which on a board is advised

# points of the curves in summary.json (about), and the relative density above which they are closer
_N_SHOWN, _SHOWN_DENSITY = 60, 1e-3


@dataclass(frozen=True, slots=True)
class Remedy:
    """Evidence that a user can add, and what it would give."""

    what: str  # the subject of a sentence
    how: str  # the option or command
    sigma: float  # relative standard deviation of the focal length from it alone


# In the order in which users can do it most easily. Sigmas: simulated drives of
# `python -m benchmarks self_calibration`; of the distance that of the sizes of cars.
_REMEDIES: Mapping[SourceKind, Remedy] = {
    "motion": Remedy(
        "a recording with a turn", "track-range calibrate drive VIDEO... --out rig.yaml", 0.015
    ),
    "known metres": Remedy("one known distance", "--known-distance", 0.05),
    "speed": Remedy("the speed of the camera (GPS)", "--ego-speed", 0.06),
}


@dataclass(frozen=True, slots=True)
class FocalSource:
    """What one kind of evidence says about the focal length."""

    kind: SourceKind
    source: str  # where it comes from, as it continues "focal length from ..."
    curve: FocalCurve  # at the points of the grid

    def robust_log_density(self, usual: FloatArray) -> FloatArray:
        """(G,) log probability of each point, if the source may be a mistake; `usual` is the
        density of the usual field of view.
        """
        mistake, density = _MISTAKE[self.kind], self.curve.density
        otherwise = usual if self.kind in _REPLACE_USUAL else np.full_like(usual, 1 / len(usual))
        return np.asarray(np.log((1 - mistake) * density + mistake * otherwise + 1e-300))


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraEstimate:
    """The focal length and the distortion of a camera, with their evidence."""

    size_px: tuple[int, int]  # width and height of the images
    sources: tuple[FocalSource, ...]
    coefficients: tuple[float, ...] = ()  # OpenCV's, of the distortion; empty = not estimated
    k1_sigma: float = math.nan  # standard deviation of k1; NaN = not estimated
    principal_px: tuple[float, float] | None = None  # of a calibration; None = the image centre

    @property
    def curve(self) -> FocalCurve:
        """The focal length by all sources, at the points of the grid."""
        log_focal = log_focal_grid(self.size_px, N_GRID)
        usual = FocalCurve.of_guess(default_guess(self.size_px), log_focal).density
        log_p = np.sum([source.robust_log_density(usual) for source in self.sources], axis=0)
        return FocalCurve(log_focal, log_p)

    def with_source(self, source: FocalSource) -> Self:
        """The estimate with one more source."""
        return replace(self, sources=(*self.sources, source))

    @property
    def focal_px(self) -> float:
        """The focal length in px (median)."""
        return self.curve.estimate[0]

    @property
    def sigma(self) -> float:
        """Its relative standard deviation."""
        return self.curve.estimate[1]

    @property
    def weights(self) -> tuple[float, ...]:
        """Weight of each source in the information on the focal length; their sum is 1."""
        precision = [source.curve.estimate[1] ** -2 for source in self.sources]
        return tuple(value / sum(precision) for value in precision)

    @property
    def leading(self) -> FocalSource:
        """The source that determines the focal length most."""
        return self.sources[int(np.argmax(self.weights))]

    @property
    def guess(self) -> FocalGuess:
        """The focal length as a guess that names its sources, the leading one first."""
        rest = [source.source for source in self.sources if source is not self.leading]
        return FocalGuess(self.focal_px, self.sigma, " and ".join([self.leading.source, *rest]))

    @property
    def k1(self) -> float:
        """First radial coefficient of the distortion, of its series; 0 = not estimated."""
        return first_radial(self.coefficients)

    @property
    def distortion(self) -> tuple[float, ...]:
        """OpenCV's coefficients of the distortion; empty = none that is worth a correction."""
        radius = math.hypot(*self.size_px) / 2 / self.focal_px
        corner_px = abs(self.k1) * radius**3 * self.focal_px
        is_significant = abs(self.k1) > _SIGNIFICANT * self.k1_sigma
        return self.coefficients if is_significant and corner_px > _VISIBLE_PX else ()

    @property
    def camera(self) -> PinholeCamera:
        """The camera of the recorded images."""
        camera = PinholeCamera.of_focal_length(self.focal_px, self.size_px)
        cx_px, cy_px = self.principal_px or (camera.cx_px, camera.cy_px)
        return replace(camera, cx_px=cx_px, cy_px=cy_px, distortion=self.distortion)

    @property
    def field_deg(self) -> float:
        """Horizontal field of view of the images with distortion."""
        edge_px = np.array([[0.0, self.camera.cy_px]])
        x, _, z = self.camera.recorded_rays(edge_px)[0].tolist()
        return 2 * math.degrees(math.atan2(-x, z))

    @property
    def remedy(self) -> tuple[Remedy, float] | None:
        """The missing evidence that would help most, and the sigma with it; None = none would."""
        present = {source.kind for source in self.sources}
        missing = [remedy for kind, remedy in _REMEDIES.items() if kind not in present]
        if not missing:
            return None
        best = min(missing, key=lambda remedy: remedy.sigma)
        sigma = (self.sigma**-2 + best.sigma**-2) ** -0.5
        return None if sigma > _WORTHWHILE * self.sigma else (best, sigma)

    @property
    def sentence(self) -> str:
        """The estimate, how well it is known, and from what."""
        focal = FocalGuess(self.focal_px, self.sigma, self.leading.source)
        lens = (
            f"; its distortion, k1 = {self.k1:+.3f} ± {self.k1_sigma:.3f}, is corrected"
            if self.distortion
            else ""
        )
        return f"{focal.text}{lens}."

    @property
    def advice(self) -> tuple[str, ...]:
        """Sentences on what would help most, and on a wide lens; empty = nothing would."""
        sentences = list[str]()
        if (helpful := self.remedy) is not None:
            remedy, sigma = helpful
            sentences.append(
                f"Most would help {remedy.what}: the focal length would be known within "
                f"{100 * sigma:.1f} % ({remedy.how})."
            )
        if self.distortion and self.field_deg > _WIDE_DEG:
            sentences.append(
                f"The lens images about {self.field_deg:.0f} degrees: a board shows its model up to "
                "the edges (track-range calibrate --lens fisheye)."
            )
        return tuple(sentences)

    def summary(self) -> dict[str, Any]:
        """Entry `camera_estimate` of summary.json, with the curves for the report's picture."""
        curve = self.curve
        shown = _shown_points(curve)
        sources = []
        for source, weight in zip(self.sources, self.weights, strict=True):
            focal_px, sigma = source.curve.estimate
            sources.append(
                {
                    "kind": source.kind,
                    "source": source.source,
                    "focal_px": round(focal_px, 1),
                    "sigma": round(sigma, 4),
                    "weight": round(weight, 3),
                    "density": _rounded_curve(source.curve.density[shown]),
                }
            )
        helpful = self.remedy
        return {
            "focal_px": round(self.focal_px, 2),
            "focal_sigma": round(self.sigma, 5),
            "k1": round(self.k1, 4) if math.isfinite(self.k1_sigma) else None,
            "k1_sigma": round(self.k1_sigma, 4) if math.isfinite(self.k1_sigma) else None,
            "is_distortion_corrected": bool(self.distortion),
            "distortion": [round(value, 5) for value in self.distortion],
            "curve_px": [round(value, 1) for value in np.exp(curve.log_focal[shown]).tolist()],
            "density": _rounded_curve(curve.density[shown]),
            "sources": sources,
            "remedy": None
            if helpful is None
            else {"evidence": helpful[0].what, "focal_sigma": round(helpful[1], 4)},
        }


def source_of_guess(guess: FocalGuess, kind: SourceKind, size_px: tuple[int, int]) -> FocalSource:
    """A focal length with a standard deviation as a source."""
    return FocalSource(
        kind, guess.source, FocalCurve.of_guess(guess, log_focal_grid(size_px, N_GRID))
    )


def source_of_curve(
    kind: SourceKind, source: str, curve: FocalCurve, size_px: tuple[int, int]
) -> FocalSource:
    """A likelihood at other focal lengths as a source."""
    return FocalSource(kind, source, curve.at(log_focal_grid(size_px, N_GRID)))


def _shown_points(curve: FocalCurve) -> IntArray:
    """(S,) points of the grid that a picture needs: some everywhere, more where the density is."""
    density = curve.density
    near = np.flatnonzero(density > _SHOWN_DENSITY * density.max())
    coarse = np.arange(0, N_GRID, N_GRID // _N_SHOWN)
    return np.union1d(coarse, near[:: max(1, len(near) // _N_SHOWN)])


def _rounded_curve(density: FloatArray) -> list[float]:
    """Values of a curve relative to the largest one."""
    return [round(float(value), 4) for value in density / density.max()]
