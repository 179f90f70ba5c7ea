"""NetworkEvidence: distances of one depth network against those of a pair, or by size, in a
drive.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from track_range.foundation.errors import Note
from track_range.foundation.files.input_files import counted
from track_range.ranging.cameras.evidence import Evidence, SeenFrame
from track_range.ranging.cameras.posterior import CameraPosterior
from track_range.ranging.cameras.unknowns import NetworkFactor, Prior, Sum, Unknown
from track_range.ranging.size_models.network_cells import CellAverages
from track_range.ranging.size_models.network_scale import (
    NetworkErrors,
    NetworkScale,
    network_scale,
)
from track_range.ranging.size_models.shared_sizes import shared_variance
from track_range.ranging.size_models.size_model import SIZE_CLASSES

# of references, relative: by size, and by the pair
_MAX_SIZE_SIGMA, _MAX_RIG_SIGMA = 0.25, 0.15
_CLEAR = 1.5  # deviation of a factor from 1, in standard deviations, that is stated
_SAYS_LITTLE = 0.5  # slope below which a network is said to tell little
_IS_EVIDENCE = np.array([not name.startswith("traffic") for name in SIZE_CLASSES])


class NetworkEvidence:
    """The distances of the network `name` in a drive, and what they are worth.

    References are the distances of the pair where there is one, else those by size, so that a frame
    counts once: the posterior knows how these two differ from other evidence.
    """

    def __init__(self, name: str, errors: NetworkErrors) -> None:
        self.name, self._errors = name, errors
        self.unknown = NetworkFactor(name)
        self._cells = CellAverages()
        self._by_rig: bool | None = None
        self._free: NetworkScale | None = None  # of the frames so far; None = not computed
        self.scale = NetworkScale(errors, errors.log_factor)

    @property
    def prior(self) -> Prior:
        """What is known of the factor of the drive before it."""
        return Prior(self._errors.drive_sigma, "usual")

    def add(self, seen: SeenFrame) -> None:
        """Add a frame."""
        network = seen.by_network.get(self.name)
        if network is None:
            return
        if self._by_rig is None:
            self._by_rig = seen.by_rig is not None
        reference = seen.by_rig if self._by_rig else seen.by_size
        if reference is None:
            return
        tracks, z = seen.tracks, network.ranges
        with np.errstate(invalid="ignore", divide="ignore"):
            variance = (reference.sigma_m / reference.distance_m) ** 2
            log_m, ratio = np.log(reference.distance_m), np.log(z.distance_m / reference.distance_m)
            is_used = tracks.observed & _IS_EVIDENCE[tracks.class_id] & np.isfinite(ratio)
            noise = np.zeros(len(tracks))
            if not self._by_rig:
                systematic = variance
                if reference.sigma_systematic_m is not None:
                    systematic = (reference.sigma_systematic_m / reference.distance_m) ** 2
                    noise = variance - systematic
                is_used &= variance < _MAX_SIZE_SIGMA**2
                variance = systematic - shared_variance(systematic)
            else:
                is_used &= variance < _MAX_RIG_SIGMA**2
        values = np.array([log_m, ratio, variance, noise])
        self._cells.add(values[:, is_used], tracks.track_id[is_used], tracks.class_id[is_used])
        self._free = None

    @property
    def evidence(self) -> list[Evidence]:
        """The factor of the network by all frames so far, over that of its references."""
        free = self._of_cells()
        if not free.n_tracks:
            return []
        of: Sum = {self.unknown: 1.0, Unknown.BASELINE if self._by_rig else Unknown.SIZES: -1.0}
        value = free.of_reference.mean - self._errors.log_factor
        return [Evidence(f"the distances of {self.name}", of, value, free.of_reference.sigma)]

    def _of_cells(self) -> NetworkScale:
        if self._free is None:
            cells = self._cells.cells
            self._free = network_scale(cells, self._errors, by_size=not self._by_rig)
        return self._free

    def update(self, cameras: CameraPosterior) -> None:
        """Take the factor of the drive from the posterior of all evidence."""
        of: Sum = {self.unknown: 1.0}
        mean = cameras.correction(of)
        self.scale = replace(
            self._of_cells(),
            log_factor=mean + self._errors.log_factor,
            sigma=cameras.sigma_of(of, mean),
        )

    @property
    def _reference(self) -> str:
        what = "the pair" if self._by_rig else "sizes"
        return f"by {what}, of {counted(self.scale.n_tracks, 'road user')}"

    @property
    def notes(self) -> tuple[Note, ...]:
        """One message on what the network is worth in this drive, if it shows it."""
        scale, factor = self.scale, math.exp(self.scale.log_factor)
        if scale.curves is None:
            sentence = (
                f"The distances of the depth network {self.name} cannot be checked in this drive: "
                f"they have the uncertainty of networks in general, ± {100 * scale.sigma:.0f} %."
            )
            return (Note(sentence, "depth-network-unchecked", "warning", "methods"),)
        slope = scale.slope
        if slope.mean < _SAYS_LITTLE:
            sentence = (
                f"The depth network {self.name} says little about distances in this drive: they "
                f"grow with the power {slope.mean:.2f} ± {slope.sigma:.2f} of those "
                f"{self._reference} (1 = right); its sigmas are accordingly wide."
            )
            return (Note(sentence, "depth-network-says-little", "warning", "methods"),)
        limit = ""
        if math.isfinite(scale.reach_m):
            limit = f" Beyond {scale.reach_m:.0f} m, its distances hardly change: wide sigmas."
        ratio = f"{factor:.2f} ± {factor * scale.sigma:.2f} times those {self._reference}"
        if abs(scale.log_factor) > _CLEAR * scale.sigma:
            sentence = (
                f"The distances of the depth network {self.name} are {ratio}: corrected.{limit}"
            )
            return (Note(sentence, "depth-network-corrected", "ok", "methods"),)
        sentence = f"The distances of the depth network {self.name} agree: {ratio}.{limit}"
        return (Note(sentence, "depth-network-agrees", "ok", "methods"),)

    def summary(self) -> dict[str, Any]:
        """The entry of the network in section `depth_networks` of summary.json."""
        scale = self.scale
        has_evidence = scale.curves is not None
        return {
            "factor": round(math.exp(scale.log_factor), 4),
            "sigma": round(scale.sigma, 4),
            "slope": round(scale.slope.mean, 3),
            "slope_sigma": round(scale.slope.sigma, 3),
            "reach_m": scale.reach_m if math.isfinite(scale.reach_m) else None,
            "track_sigma": round(scale.track_sigma, 4),
            "noise_sigma": round(scale.noise_sigma, 4),
            "n_tracks": scale.n_tracks,
            "reference": ("rig" if self._by_rig else "size") if has_evidence else None,
        }
