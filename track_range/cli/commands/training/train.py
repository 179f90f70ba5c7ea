"""`track-range train`: trains a detector on labelled images and exports it as an ONNX file."""

from __future__ import annotations

from track_range.cli.commands.training.options import TrainOptions
from track_range.cli.parameters import command
from track_range.detection.training.errors import check_torch


def _train(options: TrainOptions) -> None:
    check_torch()
    from track_range.cli.commands.training.training_run import train  # imports PyTorch

    train(options)


app = command(TrainOptions, _train)
