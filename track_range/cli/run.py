"""`track-range run`, the main command: the options of `RunSettings`, and how to watch the run."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

from track_range.cli.lazy import single_app
from track_range.cli.parameters import given_values, parameters, with_parameters
from track_range.foundation.options import Options, option
from track_range.run.settings import RunSettings, settings_from


class RunView(Options):
    """Options of a run that change nothing in its results."""

    settings: Annotated[
        Path | None,
        option("Settings file of an earlier run, settings.yaml; other options override it.", panel="Input"),
    ] = None
    show: Annotated[bool, option("Live view of the overlay in a browser.", panel="How to run")] = False
    serve: Annotated[
        str | None,
        option(
            "Port of the live view on this machine, or an address that other machines can see.",
            metavar="PORT|HOST:PORT",
            panel="How to run",
        ),
    ] = None


def _run(**values: Any) -> None:
    from track_range.cli.console import console
    from track_range.live_view.view import open_view
    from track_range.run.job import run

    chosen = RunView.of(given_values(RunView, values))
    settings = settings_from(given_values(RunSettings, values), chosen.settings)
    with open_view(show=chosen.show, serve=chosen.serve) or nullcontext() as view:
        run(settings, console, view)


app = single_app(with_parameters(_run, [*parameters(RunSettings, is_only_given=True), *parameters(RunView)]))
