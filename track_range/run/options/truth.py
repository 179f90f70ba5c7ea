"""Options of the ground truth that a run, or a finished run, is evaluated against."""

from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar

from track_range.detection.formats.titles import GENERAL_TITLES
from track_range.foundation.schemas.options import Options, option

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
            f"closing_mps (other columns are ignored); or labels with track ids: {GENERAL_TITLES}.",
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
