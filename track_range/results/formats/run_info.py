"""RunInfo: what the writers of a run know before its first frame."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from track_range.results.formats.provenance import Provenance

if TYPE_CHECKING:
    from track_range.foundation.arrays import FloatArray, Image
    from track_range.pipeline.frame_result import FrameResult
    from track_range.stereo.geometry.camera import PinholeCamera
    from track_range.stereo.geometry.mounting import Mounting
    from track_range.stereo.geometry.rig import StereoRig


@dataclass(frozen=True, slots=True, kw_only=True)
class RunInfo:
    """Properties of a run that are known before its first frame.

    `provenance`: software, model, calibration and settings of the results. `shown_image`: returns
    the (H, W, 3) uint8 BGR image of a frame that files may show, None if there is none, as for
    frames reconstructed from rows; writers take images from nowhere else. `recorded_boxes`: returns
    boxes (N, 4) in pixels of the left video for boxes in pixels of the left images.
    """

    camera: PinholeCamera  # left camera, rectified (one camera: undistorted)
    rig: StereoRig | None  # rectified stereo rig; None = one camera, or an uncalibrated pair
    fps: float  # nominal frame rate
    settings: Mapping[str, Any]  # section `run` of settings.yaml
    # names of the methods that measure in it: optional ones have columns only in these runs
    methods: Collection[str] = ()
    start_utc_s: float | None = None  # UTC of time_s = 0, in seconds since 1970; None = unknown
    provenance: Provenance = field(default_factory=Provenance)
    notes: tuple[str, ...] = ()  # messages for the user before the first frame
    mounting: Mounting | None = None  # of the camera in its vehicle; None = unknown
    # annotated video of the run, finished before `close`; None = not written
    overlay: Path | None = None
    shown_image: Callable[[FrameResult], Image | None] = lambda result: (
        result.frame.left if result.frame.left.size else None
    )
    # events of the run by column (`events.files.event_values`), all of them when writers are closed
    events: Callable[[], Sequence[Mapping[str, Any]]] = tuple
    recorded_boxes: Callable[[FloatArray], FloatArray] = lambda boxes: boxes
