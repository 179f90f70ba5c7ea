"""Evidence about the cameras, and where it comes from."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.arrays import Image
from track_range.ranging.cameras.unknowns import Sum
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.size_models.network_scale import NetworkDistances
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.odometry.ego_motion import Ego
from track_range.tracking.tracks import Tracks


@dataclass(frozen=True, slots=True)
class Evidence:
    """An equation: the sum of the unknowns times their coefficients is `value`, give or take
    `sigma`.
    """

    name: str  # where it comes from, for messages
    of: Sum  # coefficients; absent = 0
    value: float
    sigma: float
    max_chi2: float = math.inf  # largest cost of a contradiction: evidence that may be wrong alone


@dataclass(frozen=True, slots=True)
class SeenFrame:
    """What a frame shows: its tracks, and their distances by size (without the correction of the
    drive's scale) and with the scale of the rig.
    """

    tracks: Tracks
    by_size: Ranges
    by_rig: Ranges | None  # None = one camera
    ego: Ego  # motion of the camera by each source
    time_s: float
    lanes: LaneLines = field(default_factory=LaneLines)
    alignment: Alignment | None = None  # of the pair; None = that of its rig
    image: Image | None = None  # the left one, (H, W, 3)
    # distances of depth networks, without the correction of the drive's scale
    by_network: Mapping[str, NetworkDistances] = field(default_factory=dict)


class EvidenceSource(Protocol):
    """Gathers evidence from the frames of a drive; one object for each kind."""

    def add(self, seen: SeenFrame) -> None:
        """Add a frame."""

    @property
    def evidence(self) -> Sequence[Evidence]:
        """The evidence of all frames so far."""
