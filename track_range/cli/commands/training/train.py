"""`track-range train` and `anchors`; PyTorch is imported when one of the commands runs."""

from track_range.cli.commands.training.options import AnchorOptions, TrainOptions
from track_range.cli.shared.parameters import command
from track_range.detection.training.errors import check_torch


def _train(options: TrainOptions) -> None:
    check_torch()
    from track_range.cli.commands.training.training_run import train

    train(options)


def _anchors(options: AnchorOptions) -> None:
    check_torch()
    from track_range.cli.commands.training.data import print_anchors

    print_anchors(options)


app = command(TrainOptions, _train)
anchors_app = command(AnchorOptions, _anchors)
