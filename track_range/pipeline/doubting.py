"""DoubtStage: whether the drive contradicts the given values, and its scale for the next frame."""

from dataclasses import dataclass, field, replace
from typing import Any

from track_range.detection.lanes.lines import LaneLines
from track_range.pipeline.ranging import FrameRanges
from track_range.ranging.cameras.doubt import Doubt, Errors, errors_of
from track_range.ranging.cameras.evidence import SeenFrame
from track_range.ranging.cameras.learnt_focal import FocalEstimate
from track_range.ranging.cameras.posterior import posterior
from track_range.ranging.cameras.scale_check import ScaleCheck
from track_range.ranging.cameras.unknowns import CameraPriors
from track_range.ranging.size_models.drive_scale import DriveScale
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import Ego
from track_range.tracking.tracks import Tracks


@dataclass(slots=True)
class DoubtStage:
    """Checks what was given of the cameras, and estimates what was not."""

    priors: CameraPriors = field(default_factory=dict)  # nothing is unknown
    check: ScaleCheck | None = None  # None = nothing is checked
    focal: FocalEstimate | None = None  # before the drive; None = the focal length was given
    _errors: Errors = field(init=False)
    _doubt: Doubt = field(init=False)

    def __post_init__(self) -> None:
        self._errors = errors_of(self.priors)
        doubt = Doubt.of(posterior(self.priors, []), self._errors, None, self.initial_scale)
        self._doubt = replace(doubt, focal=self.focal)

    @property
    def initial(self) -> Doubt:
        """The doubt before the first frame: that of the priors."""
        return self._doubt

    @property
    def initial_scale(self) -> DriveScale:
        """The scale of the drive before the first frame."""
        return self._with_scales(DriveScale())

    def _with_scales(self, scale: DriveScale) -> DriveScale:
        """With the scales of the pair, of the road, of the focal length and of networks, as far as
        known.
        """
        check = self.check
        if check is None:
            return scale
        networks = check.network_scales
        known = scale.rig, scale.road, scale.focal, scale.network
        if known == (check.rig_scale, check.road_scale, check.focal_scale, networks):
            return scale
        return replace(
            scale,
            rig=check.rig_scale,
            road=check.road_scale,
            focal=check.focal_scale,
            network=networks,
        )

    def update(
        self,
        tracks: Tracks,
        measured: FrameRanges,
        ego: Ego,
        lanes: LaneLines | None,
        scale: DriveScale,
        frame: Frame,
    ) -> tuple[Doubt, DriveScale]:
        """The doubt after a frame, and the scale of the drive for the next frame.

        While there is doubt, the scale has no evidence: neither corrects the other in circles.
        """
        check, by_size = self.check, measured.by_size
        if check is not None and by_size is not None:
            seen = SeenFrame(
                tracks,
                by_size,
                measured.by_rig,
                ego,
                frame.time_s,
                lanes or LaneLines(),
                measured.alignment,
                frame.left,
                measured.by_network,
            )
            if check.update(seen):
                doubt = Doubt.of(check.cameras, self._errors, check.doubt, self.initial_scale)
                focal = check.focal or self.focal
                self._doubt = replace(doubt, height_m=check.height_m, focal=focal)
        doubt = self._doubt.zoomed(ego.focal_change)
        is_in_doubt = self._doubt.scale is not None
        after = DriveScale() if is_in_doubt else scale.after(measured.evidence, frame.time_s)
        return doubt, self._with_scales(after)

    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        return () if self.check is None else self.check.notes

    def summary(self) -> dict[str, Any]:
        """Sections of summary.json."""
        return {} if self.check is None else self.check.summary()
