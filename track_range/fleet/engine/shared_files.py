"""Files that all clips share, such as a detector: their content goes to the workers on other machines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from track_range.fleet.engine.plan import FleetPlan
from track_range.fleet.errors import FleetError
from track_range.foundation.files.input_files import read_bytes

_MAX_BYTES = 2_000_000_000
"""Size limit of a shared file."""


@dataclass(frozen=True, slots=True)
class SharedFile:
    """A file for workers on other machines.

    Attributes:
        name: name of the file.
        content: its content.
    """

    name: str
    content: bytes


def shared_files(plan: FleetPlan) -> dict[str, SharedFile]:
    """The files in the options of a plan, by setting.

    Raises:
        FleetError: a file cannot be read.
    """
    paths = {name: Path(plan.options[name]) for name in plan.shared if name in plan.options}
    return {
        name: SharedFile(path.name, read_bytes(path, FleetError, f"the file of --{name}", max_bytes=_MAX_BYTES))
        for name, path in paths.items()
    }


def with_shared_files(plan: FleetPlan, files: Mapping[str, SharedFile], folder: Path) -> FleetPlan:
    """The plan with the paths of local copies of the files.

    Args:
        plan: of the fleet.
        files: the files by setting; without one, its path is that on the machine of the driver.
        folder: folder for the copies.
    """
    options = dict(plan.options)
    for name, file in files.items():
        path = folder / name / file.name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(file.content)
        options[name] = str(path)
    return replace(plan, options=options)
