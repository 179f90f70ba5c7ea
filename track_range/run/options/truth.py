"""Options of the ground truth that a run, or a finished run, is evaluated against."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from track_range.detection.formats.titles import GENERAL_TITLES
from track_range.foundation.schemas.options import Options, option

if TYPE_CHECKING:
    from track_range.ranging.truth.truth import TruthChoices

_clip_option = partial(option, is_per_clip=True)


class TruthOptions(Options):
    """Ground truth."""

    panel: ClassVar = "Ground truth"
    stage: ClassVar = "tracks"

    truth: Annotated[
        Path | None,
        _clip_option(
            "Ground truth to measure the errors against: KITTI tracking labels, or a CSV with the "
            "columns frame, id, class, x1, y1, x2, y2, distance_m and optionally visible_share, "
            f"closing_mps (other columns are ignored); or labels with track ids: {GENERAL_TITLES}; or "
            "targets without boxes, a CSV with the columns time_s, target, range_m, and optionally "
            "range_rate_mps, lateral_m.",
            instead="ground truth belongs to a clip; give it in the column truth of a manifest",
        ),
    ] = None
    truth_calib: Annotated[
        Path | None,
        _clip_option(
            "Calibration file of the camera of KITTI labels (default: the camera that their 2-D "
            "and 3-D boxes determine, else that of the run)."
        ),
    ] = None
    truth_poses: Annotated[
        Path | None,
        _clip_option(
            "Poses of the camera for targets at places in a map: a CSV with the columns time_s, "
            "x_m, y_m, heading_deg."
        ),
    ] = None
    truth_ahead_m: Annotated[
        float,
        _clip_option(
            "Position of the sensor of the targets, or of the point of the poses, ahead of the "
            "camera, in metres.",
            ge=-50.0,
            le=50.0,
        ),
    ] = 0.0
    truth_offset_s: Annotated[
        float | None,
        _clip_option(
            "Time of the video minus the time of the targets, in seconds (default: estimated from "
            "how distances and speeds change, up to 5 s)."
        ),
    ] = None

    @property
    def truth_choices(self) -> "TruthChoices":
        """What is given besides the file."""
        from track_range.ranging.truth.truth import TruthChoices  # imports NumPy

        return TruthChoices(
            self.truth_calib, self.truth_poses, self.truth_ahead_m, self.truth_offset_s
        )
