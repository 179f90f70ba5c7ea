"""Evaluation of ranging methods on labelled boxes, with the images of the labels if they are
given.
"""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from track_range.foundation.progress import StepProgress, no_progress
from track_range.ranging.evaluation.image_methods import (
    LabelledImageError,
    MethodInputs,
    OpenedSequence,
)
from track_range.ranging.evaluation.labelled_ranges import evaluate_ranges as _evaluate_ranges
from track_range.ranging.evaluation.settings import RangeEvaluationSettings
from track_range.ranging.registry import network_names, register_networks
from track_range.ranging.truth.labelled_boxes import file_in
from track_range.recording.recording import open_recording
from track_range.recording.sources.files.image_names import named_images


def evaluate_ranges(
    settings: RangeEvaluationSettings, progress: StepProgress = no_progress
) -> dict[str, Any]:
    """Errors and calibration of sigma per method and class, as plain values for JSON; see
    `ranging.evaluation.labelled_ranges`.

    Raises VideoError besides: an image cannot be read.
    """
    images = None
    if settings.images is not None:
        images = SequenceImages(
            settings.images,
            settings.right_images,
            calib=settings.calib,
            align=settings.align,
            is_one=settings.labels.is_file(),
        )
    depth_models = network_names("depth", settings.depth_model)
    stereo_models = network_names("disparity", settings.stereo_model)
    register_networks((*depth_models, *stereo_models))
    inputs = MethodInputs(
        images=images, depth_models=depth_models, stereo_models=stereo_models, progress=progress
    )
    return _evaluate_ranges(settings, inputs)


@dataclass(frozen=True, slots=True)
class SequenceImages:
    """Images in folders of sequences, or videos, that are named like the files of labels."""

    left: Path
    right: Path | None
    calib: Path  # folder of calibration files of these names, or the file of all sequences
    align: str  # correction of the disparities of pairs: "auto", "off" or a file
    is_one: bool  # whether there is one sequence, whose images may be the folder or video itself

    @property
    def has_pairs(self) -> bool:
        """See `LabelledImages`."""
        return self.right is not None

    @contextmanager
    def opened(self, name: str) -> Iterator[OpenedSequence]:
        """See `LabelledImages`; raises LabelledImageError if the sequence has no images."""
        left = self._images(self.left, name, "--images")
        right = None if self.right is None else self._images(self.right, name, "--right-images")
        recording = open_recording(
            left,
            right,
            rig=file_in(self.calib, f"{name}.txt"),
            align=self.align,
            has_checks=False,
        )
        # labels count as the names of images do, frames of a recording from its first one
        first = named_images(left).images[0][0] if left.is_dir() else 0
        with closing(recording):
            frames = (replace(frame, index=frame.index + first) for frame in recording.frames)
            yield OpenedSequence(str(left), frames, recording.camera, recording.rig)

    def _images(self, place: Path, name: str, option: str) -> Path:
        inside = sorted(place.iterdir()) if place.is_dir() else []
        named = [file for file in inside if name in (file.name, file.stem)]
        if named:
            return named[0]
        if self.is_one and place.exists():
            return place
        raise LabelledImageError(
            f"{option} {place}: expected the images of the labels {name}.txt in a "
            f"folder {name}, or a "
            f"video such as {name}.mp4, found neither."
        )
