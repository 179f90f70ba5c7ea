"""`track-range export`: a finished run or a label file in another format."""

from __future__ import annotations

from track_range.cli.shared.console import console, print_line, print_notes
from track_range.cli.shared.parameters import command
from track_range.foundation.files.input_files import counted
from track_range.run.export.export import ExportSettings, export


def _export(settings: ExportSettings) -> None:
    exported = export(settings)
    print_notes(console, exported.notes)
    counts = ((exported.n_boxes, "box", "boxes"), (exported.n_scenarios, "scenario", "scenarios"))
    written = [f", {counted(n, one, several)}" for n, one, several in counts if n is not None]
    images = f" and {counted(exported.n_images, 'image')}" if settings.images else ""
    print_line(console, f"Written: {settings.out}{''.join(written)}{images}")


app = command(ExportSettings, _export)
