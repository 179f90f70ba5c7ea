"""check_json_file: the file for results is not one of the inputs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from track_range.results.output_files import OutputError

_OUTPUTS = ("json_file", "table", "figure")
"""Options that name files to write."""


def check_json_file(options: Any) -> None:
    """Refuse to replace an input by the results; called before the evaluation.

    Args:
        options: options of a command with `json_file`; all other paths in them, and the files in folders, are inputs.

    Raises:
        OutputError: the file is an input.
    """
    json_file: Path | None = options.json_file
    if json_file is None or not json_file.exists():
        return
    for name, value in vars(options).items():
        if name not in _OUTPUTS and any(_contains(path, json_file) for path in _paths(value)):
            flag = name.replace("_", "-")
            raise OutputError(f"{json_file}: expected a new file for --json, got that of --{flag}; rename it.")


def _paths(value: object) -> Iterable[Path]:
    values = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    return (path for path in values if isinstance(path, Path) and path.exists())


def _contains(path: Path, file: Path) -> bool:
    """Whether a path is a file, or the folder of a run or of labels with that file as input."""
    return path.samefile(file) or (path.is_dir() and path.samefile(file.parent) and file.suffix != ".json")
