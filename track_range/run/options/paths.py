"""Which settings of a run are paths, and the files that a run reads."""

from collections.abc import Sequence
from pathlib import Path

from track_range.foundation.schemas.options import is_file, is_path
from track_range.recording.sources.names import source_of
from track_range.run.options.settings import RunSettings

# names of settings that are, or may be, paths or lists of them; that the run reads; and that are
# always paths
FILES = RunSettings.fields_where(is_file)
INPUT_FILES = {name for name in FILES if RunSettings.stage_of(name) != "outputs"}
PATHS = RunSettings.fields_where(is_path)


# settings that are networks, whose files have others beside them
NETWORKS = ("depth_model", "stereo_model")


def files_by_setting(settings: RunSettings) -> dict[str, list[Path]]:
    """Files and folders that a run reads, by the name of the setting, or `left` and `right`; words
    that are given instead of files name none.
    """
    sides = ("mono",) if settings.stereo is None else ("left", "right")
    videos = {
        side: source_of(video).files for side, video in zip(sides, settings.videos, strict=False)
    }
    named = {name: getattr(settings, name) for name in sorted(INPUT_FILES)}
    given = {name: paths_of(value) for name, value in named.items()}
    given |= {name: network_files(given[name]) for name in NETWORKS}
    return {**videos, **{name: paths for name, paths in given.items() if paths}}


def network_files(paths: Sequence[Path]) -> list[Path]:
    """The ONNX files of networks, each with its settings and its weights, if it has files of them;
    ModelError: one is no ONNX file.
    """
    if not paths:
        return []
    from track_range.detection.models.onnx_session import check_model_file  # imports onnxruntime
    from track_range.ranging.networks.recognition import settings_file

    files: list[Path] = []
    for path in paths:
        weights = check_model_file(path)
        settings = settings_file(path)
        files += [path, *([settings] if settings.is_file() else []), *weights]
    return files


def input_files(settings: RunSettings) -> list[Path]:
    """All files that a run reads, and words given instead of files."""
    named = (getattr(settings, name) for name in RunSettings.model_fields if name in INPUT_FILES)
    videos = (file for video in settings.videos for file in source_of(video).files)
    return [*videos, *(path for value in named for path in paths_of(value))]


def paths_of(value: str | Path | Sequence[Path] | None) -> list[Path]:
    """The paths in the value of a setting; None = none."""
    if value is None:
        return []
    return [Path(one) for one in ((value,) if isinstance(value, str | Path) else value)]
