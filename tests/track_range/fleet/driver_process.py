"""`python -m tests.track_range.fleet.driver_process OUT CLIPS N [ADDRESS]`: a driver of stub clips
to be killed."""

from __future__ import annotations

import sys
from pathlib import Path

from rich.console import Console

from tests.track_range.fleet.stub_clips import process_stub, stub_clips
from track_range.fleet.engine.fleet_run import run_fleet
from track_range.fleet.settings import FleetSettings
from track_range.foundation.errors import UserError


def main(out: str, clips: str, n_clips: str, address: str | None = None) -> int:
    """Process N clips that take half a second each."""
    settings = FleetSettings(
        recordings=("x",), out=out, workers=2, worker_memory="1GB", address=address
    )
    names = [f"slow-{number}" for number in range(int(n_clips))]
    try:
        run_fleet(
            settings, {}, stub_clips(Path(clips), *names), process=process_stub, console=Console()
        )
    except UserError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_status
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
