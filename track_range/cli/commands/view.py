"""`track-range view`: a finished run in the Rerun viewer."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Annotated

from track_range.cli.shared.console import console, print_line, print_notes
from track_range.cli.shared.parameters import command
from track_range.foundation.errors import UserError
from track_range.foundation.files.folder_lock import is_locked
from track_range.foundation.library_telemetry import VIEWER_VARIABLES
from track_range.foundation.schemas.options import Options, option
from track_range.results.formats.rerun_file import RERUN_FILE, RerunWriter
from track_range.run.export.export import ExportSettings, export
from track_range.run.export.source import is_run


class ViewError(UserError):
    """The viewer cannot be started."""


class ViewOptions(Options):
    """Options of `track-range view`."""

    run: Annotated[Path, option("Result folder of a run.", metavar="RUN", is_argument=True)]
    web: Annotated[bool, option("Viewer as a page in the browser, served on this machine.")] = False


def _view(options: ViewOptions) -> None:
    RerunWriter().check_requirements()
    path = recording_of(options.run)
    print_line(console, f"Opening {path}; close the viewer or press Ctrl-C to end.")
    try:
        status = subprocess.run(
            viewer_command(path, is_web=options.web),
            env={**os.environ, **VIEWER_VARIABLES},
            check=False,
        ).returncode
    except OSError as error:
        raise ViewError(f"{path}: the Rerun viewer cannot be started ({error}).") from error
    except KeyboardInterrupt:
        return
    if status > 0:
        raise ViewError(
            f"{path}: the Rerun viewer ended with status {status}; without a display, use "
            "track-range view --web."
        )


def recording_of(run: Path) -> Path:
    """The run.rrd of a run, made from its other files if there is none; ViewError or
    OutputError.
    """
    path = run / RERUN_FILE
    if not is_run(run):
        raise ViewError(f"{run}: expected the result folder of a run, found none.")
    if not path.is_file():  # not written, or the run was killed
        if is_locked(run):
            raise ViewError(
                f"{run}: the run is in progress; wait for its end, or export it with `track-range "
                "export --to rrd` to another folder."
            )
        print_notes(console, export(ExportSettings(source=run, to="rrd", out=path)).notes)
    return path


def viewer_command(path: Path, *, is_web: bool) -> list[str]:
    """Command line of the viewer, which can be reached from this machine only."""
    return [
        sys.executable,
        "-m",
        "rerun",
        "--bind",
        "127.0.0.1",
        *(["--web-viewer"] if is_web else []),
        str(path),
    ]


app = command(ViewOptions, _view)
