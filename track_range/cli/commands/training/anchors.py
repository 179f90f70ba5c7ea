"""`track-range anchors`: fits anchors to the boxes of a data set."""

from __future__ import annotations

from track_range.cli.commands.training.options import AnchorOptions
from track_range.cli.parameters import command
from track_range.detection.training.errors import check_torch


def _anchors(options: AnchorOptions) -> None:
    check_torch()
    from track_range.cli.commands.training.data import print_anchors  # imports PyTorch

    print_anchors(options)


app = command(AnchorOptions, _anchors)
