"""clips_of: the clips of a fleet, from folders, patterns of file names and manifests."""

from __future__ import annotations

from collections.abc import Sequence

from track_range.fleet.inputs.clip import Clip


def clips_of(recordings: Sequence[str], pattern: str | None, rig: str | None) -> list[Clip]:
    """The clips that a command line names, sorted by name.

    Args:
        recordings: folders, files, patterns such as `DIR/*.mp4`, and manifests (.csv, .parquet), local or remote.
        pattern: names of the files of a clip, relative to a folder: `{clip}.mp4` for one camera,
            `{clip}_left.mp4,{clip}_right.mp4` for two; other placeholders become labels. None = every video is a clip.
        rig: calibration file of all clips, which may contain the placeholders of the pattern; None = as in a run.

    Raises:
        FleetInputError: nothing is found, names are not unique, or a pattern or manifest is wrong.
        StorageError: a storage cannot be reached.
    """
    raise NotImplementedError
