"""DoubtStage: whether the drive contradicts the given values, and its scale for the next frame."""

from dataclasses import dataclass, field, replace
from typing import Any

from track_range.detection.lanes.lines import LaneLines
from track_range.pipeline.ranging import FrameRanges
from track_range.ranging.cameras.doubt import Doubt, SharedErrors
from track_range.ranging.cameras.evidence import SeenFrame
from track_range.ranging.cameras.scale_check import ScaleCheck
from track_range.ranging.measurement.rig_scale import CALIBRATED
from track_range.ranging.size_models.drive_scale import DriveScale
from track_range.stereo.odometry.ego_motion import Ego
from track_range.tracking.tracks import Tracks


@dataclass(slots=True)
class DoubtStage:
    """Checks what was given; `calibration_sigma` is the relative error of all distances by the
    calibration.
    """

    check: ScaleCheck | None = None  # None = nothing is checked
    calibration_sigma: float = 0.0
    _shared: SharedErrors = field(init=False)

    def __post_init__(self) -> None:
        has_rig = self.check is not None and self.check.baseline_m is not None
        self._shared = SharedErrors(self.calibration_sigma, has_rig=has_rig)

    @property
    def initial(self) -> Doubt:
        """The doubt before the first frame: none."""
        return self._shared.doubt(None)

    @property
    def initial_scale(self) -> DriveScale:
        """The scale of the drive before the first frame."""
        return DriveScale(rig=CALIBRATED if self.check is None else self.check.rig_scale)

    def update(
        self,
        tracks: Tracks,
        measured: FrameRanges,
        ego: Ego,
        lanes: LaneLines | None,
        scale: DriveScale,
        time_s: float,
    ) -> tuple[Doubt, DriveScale]:
        """The doubt after a frame, and the scale of the drive for the next frame.

        While there is doubt, the scale has no evidence: neither corrects the other in circles.
        """
        contradiction = None if self.check is None else self.check.doubt
        by_size = measured.by_size
        if self.check is not None and by_size is not None:
            seen = SeenFrame(tracks, by_size, measured.by_rig, ego, time_s, lanes or LaneLines())
            contradiction = self.check.update(seen)
        rig = CALIBRATED if self.check is None else self.check.rig_scale
        after = DriveScale() if contradiction else scale.after(measured.evidence, time_s)
        return self._shared.doubt(contradiction, rig), replace(after, rig=rig)

    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        return () if self.check is None else self.check.notes

    def summary(self) -> dict[str, Any]:
        """Sections of summary.json."""
        return {} if self.check is None else self.check.summary()
