"""Trainings of seconds on drawn scenes."""

import torch

from track_range.detection.training.data.augmentation import AugmentationSettings
from track_range.detection.training.settings import TrainingSettings

SMALL = TrainingSettings(
    size_px=96, n_epochs=4, batch_size=4, validate_every=2, augmentation=AugmentationSettings()
)


class Quiet:
    """Listener that does nothing."""

    def step(self, epoch, i, n, losses): ...

    def validated(self, epoch, i, n): ...

    def epoch(self, row): ...


class Killed(Quiet):
    """Listener that stops a run in the middle of its third epoch."""

    def step(self, epoch, i, n, losses):
        if epoch == 2 and i == 2:
            raise KeyboardInterrupt


def weights(run):
    return torch.cat(
        [value.flatten().float() for value in run.average.network.state_dict().values()]
    )
