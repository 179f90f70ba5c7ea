"""companions: the files and folders beside a video that belong to it by their names.

A run finds them by these names, and a fleet fetches them with the video.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Literal

from track_range.recording.sources.files.image_names import TIME_FILES
from track_range.recording.telemetry.sidecars.reading import OXTS_NAME, TABLE_NAME, sidecar_names
from track_range.recording.video.file_names import VIDEO_SUFFIXES
from track_range.stereo.rig_formats.reading import rig_names

Role = Literal["rig", "times", "speed", "telemetry"]


def companions(video: str, *, is_folder: bool = False) -> Mapping[Role, tuple[str, ...]]:
    """Names of files that may belong to a video with this name, in the order in which they are
    looked for, by their role; a name that ends with "/" is that of a folder.

    They lie beside the video: `rig` is its calibration, of which the first counts, `speed` its
    speed, both with the name of the video or for all videos of the folder, and `telemetry` its
    records with times. Those of a folder of images (`is_folder`) also lie in it, as the `times` of
    its images do.
    """
    return {
        "rig": rig_names(video),
        "times": TIME_FILES if is_folder else (),
        "speed": (f"{Path(video).stem}.{TABLE_NAME}", TABLE_NAME, f"{OXTS_NAME}/"),
        "telemetry": () if is_folder else sidecar_names(video),
    }


def shared_note(file: Path, videos: Collection[Path]) -> str:
    """A sentence on a file beside the videos of a recording that also counts for other videos of
    its folder; "" = it does not.
    """
    video = next(iter(videos))
    if file.name.startswith(f"{video.stem}.") or not file.is_file():
        return ""
    own = {path.absolute() for path in videos}
    others = [
        path
        for path in file.parent.iterdir()
        if path.suffix.lower() in VIDEO_SUFFIXES and path.absolute() not in own
    ]
    if not others:
        return ""
    return (
        f" It counts for every video of its folder, such as {min(path.name for path in others)}: "
        f"rename it to {video.stem}.{file.name} if it is of this one alone."
    )
