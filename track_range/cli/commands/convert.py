"""`track-range convert`: data sets of others in the layout of recordings and truth."""

from track_range.cli.shared.console import console, print_line
from track_range.cli.shared.parameters import command
from track_range.evaluation.datasets.convert import ConvertSettings, convert


def _convert(options: ConvertSettings) -> None:
    for line in convert(options):
        print_line(console, line)


app = command(ConvertSettings, _convert)
