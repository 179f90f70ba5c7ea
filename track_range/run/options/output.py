"""Options of a run for its files."""

from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import field_validator

from track_range.foundation.schemas.options import Options, option
from track_range.results.formats.mcap import PROFILES
from track_range.results.writers import DEFAULT_WRITERS, FILES_OF_WRITERS, WRITERS

_file_option = partial(option, stage="outputs")


class OutputOptions(Options):
    """The files of a run."""

    panel: ClassVar = "Output"

    out: Annotated[
        Path | None,
        _file_option(
            "Folder of the results (default: LEFT-track-range in the current folder).",
            metavar="DIR",
            is_shared=True,
        ),
    ] = None
    overwrite: Annotated[
        bool,
        _file_option(
            "Replacement of the results of another recording in the folder. Results of the same "
            "recording are replaced without this option.",
            instead="a fleet has an option of its own, --overwrite",
        ),
    ] = False
    write: Annotated[
        tuple[str, ...],
        _file_option(
            "Formats of the result files: "
            f"{', '.join(f'{name} ({text})' for name, text in FILES_OF_WRITERS.items())}, or "
            "formats of installed packages.",
            metavar="A,B,...",
        ),
    ] = DEFAULT_WRITERS
    anonymize: Annotated[
        bool,
        option(
            "Irreversible blur of heads and number plates in all images of the results, and no "
            "folder names in the results; undetected heads and plates are not blurred.",
            # it blurs more than the boxes that a detector reports
            stage="detections",
        ),
    ] = False
    mcap_profile: Annotated[
        str,
        _file_option(
            "Message types of run.mcap: Foxglove's, or ROS 2's (CDR).", choices=PROFILES.keys
        ),
    ] = "foxglove"
    mcap_images: Annotated[
        bool, _file_option("Images in run.mcap, as JPEG.", flag="--mcap-images/--no-mcap-images")
    ] = False
    table: Annotated[
        Path | None,
        _file_option(
            "Markdown file for the tables of the run.",
            metavar="FILE.md",
            instead="every clip would overwrite the file; use `track-range fleet report`",
        ),
    ] = None
    keep_gps: Annotated[
        bool,
        _file_option(
            "Output of the recording's positions in telemetry.csv; without this option, results "
            "have no positions."
        ),
    ] = False
    overlay: Annotated[
        bool, _file_option("Annotated video, overlay.mp4.", flag="--overlay/--no-overlay")
    ] = True
    clips: Annotated[
        bool,
        _file_option(
            "Short video of each event in the folder clips, cut from overlay.mp4: from 3 s before "
            "its start to 2 s after its end."
        ),
    ] = False
    disparity: Annotated[
        bool,
        _file_option(
            "Video of the depths of all pixels by dense stereo or a network, disparity.mp4.",
            flag="--disparity/--no-disparity",
        ),
    ] = False
    overlay_disparity: Annotated[
        bool,
        _file_option(
            "Colour-coded depths of dense stereo or a network below each frame of the overlay.",
            flag="--overlay-disparity/--no-overlay-disparity",
            old_names=("overlay_side",),
        ),
    ] = False
    overlay_cuboids: Annotated[
        bool,
        _file_option(
            "Cuboids of the road users on the overlay in place of their boxes in the image.",
            flag="--overlay-cuboids/--no-overlay-cuboids",
        ),
    ] = False
    overlay_recorded: Annotated[
        bool,
        _file_option(
            "Overlay on the recorded images of a wide lens instead of the undistorted images.",
            flag="--overlay-recorded/--no-overlay-recorded",
        ),
    ] = False

    @field_validator("write")
    @classmethod
    def _known_writers(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        known = WRITERS.names
        if unknown := [name for name in names if name not in known]:
            raise ValueError(f"unknown format {', '.join(unknown)}: expected {', '.join(known)}")
        return tuple(dict.fromkeys(names))
