"""`track-range evaluate run`: errors of a finished run against ground truth."""

from track_range.cli.commands.evaluate.result_files import JsonField, check_result_files
from track_range.cli.shared.console import console, print_grid, print_line, print_notes
from track_range.cli.shared.parameters import command
from track_range.evaluation.run_evaluation import RunEvaluationSettings, evaluate_run
from track_range.foundation.files.output_files import write_json
from track_range.views import tables


class RunOptions(RunEvaluationSettings):
    """Options of `track-range evaluate run`."""

    json_file: JsonField = None


def _run(options: RunOptions) -> None:
    check_result_files(options)
    figures = evaluate_run(options)
    mot = tables.mot_grid(figures["tracks"])
    cuboids = tables.cuboid_grids(figures["cuboids"]) if "cuboids" in figures else []
    print_grid(console, *tables.accuracy_grids(figures), *([mot] if mot.rows else []), *cuboids)
    print_line(console, f"Ground truth: {figures['truth']}.")
    if rule := figures["tracks"].get("rule"):
        print_line(console, f"Rule of the tracking metrics: {rule}.")
    print_notes(console, figures["notes"])
    write_json(options.json_file, figures)


app = command(RunOptions, _run)
