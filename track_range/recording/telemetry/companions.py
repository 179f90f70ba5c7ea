"""companions: the files and folders beside a video that belong to it by their names.

A run finds them by these names, and a fleet fetches them with the video.
"""

from collections.abc import Mapping
from typing import Literal

from track_range.recording.sources.files.image_names import TIME_FILES
from track_range.recording.telemetry.sidecars.reading import OXTS_NAME, TABLE_NAME, sidecar_names
from track_range.stereo.rig_formats.reading import RIG_NAMES

Role = Literal["rig", "times", "speed", "telemetry"]


def companions(video: str, *, is_folder: bool = False) -> Mapping[Role, tuple[str, ...]]:
    """Names of files that may belong to a video with this name, in the order in which they are
    looked for, by their role; a name that ends with "/" is that of a folder.

    They lie beside the video: `rig` is its calibration, of which the first counts, `speed` its
    speed, and `telemetry` its records with times. Those of a folder of images (`is_folder`) also
    lie in it, as the `times` of its images do.
    """
    return {
        "rig": RIG_NAMES,
        "times": TIME_FILES if is_folder else (),
        "speed": (TABLE_NAME, f"{OXTS_NAME}/"),
        "telemetry": () if is_folder else sidecar_names(video),
    }
