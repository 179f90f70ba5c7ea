"""Options of a run for a camera that stands still: the plane of its road, and what it counts."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar, Self

from pydantic import model_validator

from track_range.foundation.schemas.options import Options, contradiction, option

_clip_option = partial(option, is_per_clip=True)
_PLACE = "in pixels of the video, such as"


class FixedCameraOptions(Options):
    """A camera that stands still: on a bridge, a pole, or at a window."""

    panel: ClassVar = "Fixed camera"
    stage: ClassVar = "tracks"

    static_camera: Annotated[
        bool,
        _clip_option(
            "Camera that stands still: no motion of its own is sought, and there are no lanes, times "
            "to collision or warnings; speeds are over ground."
        ),
    ] = False
    ground: Annotated[
        Path | None,
        _clip_option(
            "With --static-camera, the plane of the road in metres, written by `track-range "
            "calibrate ground` (default: from --mount with the height z and the pitch; else speeds "
            "rest on usual sizes of road users)."
        ),
    ] = None
    count_line: Annotated[
        tuple[str, ...],
        option(
            "With --static-camera, line at which road users are counted and measured, by its ends "
            f"{_PLACE} north=300,520,980,540; repeat the option for further lines.",
            metavar="NAME=X1,Y1,X2,Y2",
            is_repeated=True,
        ),
    ] = ()
    zone: Annotated[
        tuple[str, ...],
        option(
            "With --static-camera, area whose entries, exits and dwell times are counted, by its "
            f"corners {_PLACE} stop=300,500,500,500,520,620; repeat the option for further zones.",
            metavar="NAME=X1,Y1,...",
            is_repeated=True,
        ),
    ] = ()

    @model_validator(mode="after")
    def _of_static_camera(self) -> Self:
        from track_range.results.counts.places import parsed_places  # imports NumPy

        for name in ("ground", "count_line", "zone"):
            if getattr(self, name) and not self.static_camera:
                raise contradiction(
                    f"{self.flag(name)} is for a camera that stands still: places in the image have no "
                    "place on the road when the camera moves; add --static-camera, or omit the option",
                    (name, "static_camera"),
                )
        if self.count_line or self.zone:
            parsed_places(self.count_line, self.zone)
        return self
