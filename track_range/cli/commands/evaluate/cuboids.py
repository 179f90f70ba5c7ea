"""`track-range evaluate cuboids`: sizes, headings and places of measured 3-D boxes."""

from track_range.cli.commands.evaluate.result_files import JsonField, check_result_files
from track_range.cli.shared.console import console, print_grid, print_notes
from track_range.cli.shared.parameters import command
from track_range.evaluation.motion.cuboids import evaluate_cuboids
from track_range.evaluation.motion.settings import CuboidEvaluationSettings
from track_range.foundation.files.output_files import write_json
from track_range.views.tables import cuboid_grids


class CuboidOptions(CuboidEvaluationSettings):
    """Options of `track-range evaluate cuboids`."""

    json_file: JsonField = None


def _cuboids(options: CuboidOptions) -> None:
    check_result_files(options)
    figures = evaluate_cuboids(options)
    print_grid(console, *cuboid_grids(figures["cuboids"]))
    print_notes(console, figures["notes"])
    write_json(options.json_file, figures)


app = command(CuboidOptions, _cuboids)
