"""Ranging methods that need images or further inputs, on labelled boxes: measured as in a run, with
the distances by size beside them, in the frames that have labels.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from track_range.foundation.arrays import IntArray
from track_range.foundation.errors import UserError
from track_range.foundation.progress import StepProgress, no_progress
from track_range.ranging.cameras.scale_check import ScaleCheck
from track_range.ranging.cameras.unknowns import camera_priors
from track_range.ranging.evaluation.box_evaluation import frame_rows
from track_range.ranging.evaluation.box_frames import (
    SequenceRangers,
    as_frames,
    store,
    unmeasured,
    without_empty_systematic,
)
from track_range.ranging.methods.method import (
    MethodContext,
    MethodError,
    RangingMethod,
    Requirement,
)
from track_range.ranging.registry import create_rangers
from track_range.ranging.truth.errors import MethodColumn
from track_range.ranging.truth.labelled_boxes import BoxSet
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.tracking.tracks import Tracks

# largest difference of the size of images from that of the labels' camera: videos have even sizes
_MAX_SIZE_DIFFERENCE = 0.02


class LabelledImageError(UserError):
    """Images of labelled sequences that cannot be used; the message names the sequence."""


@dataclass(frozen=True, slots=True)
class OpenedSequence:
    """The images of a labelled sequence."""

    source: str  # for messages
    frames: Iterator[Frame]  # in order, numbered as the labels
    camera: PinholeCamera  # the (left) camera
    rig: StereoRig | None  # of a pair; None = one camera


class LabelledImages(Protocol):
    """Images of labelled sequences, which are opened one after the other."""

    @property
    def has_pairs(self) -> bool:
        """Whether there are images of both cameras."""

    def opened(self, name: str) -> AbstractContextManager[OpenedSequence]:
        """The images of the sequence with this name, until the end of the context."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodInputs:
    """What methods may need besides boxes and a camera."""

    images: LabelledImages | None = None
    depth_models: Mapping[str, Path] = field(default_factory=dict)  # by name of the method
    stereo_models: Mapping[str, Path] = field(default_factory=dict)
    progress: StepProgress = no_progress

    @property
    def networks(self) -> tuple[str, ...]:
        """Names of the methods that have a network."""
        return (*self.depth_models, *self.stereo_models)

    def available(self, camera_height_m: float | None) -> frozenset[Requirement]:
        """Requirements that are met."""
        has_pairs = self.images is not None and self.images.has_pairs
        is_met: dict[Requirement, bool] = {
            "image": self.images is not None,
            "rig": has_pairs,
            "right_image": has_pairs,
            "dense_disparity": has_pairs,
            "camera_height": camera_height_m is not None,
        }
        return frozenset(name for name, met in is_met.items() if met)


def image_columns(
    boxes: BoxSet,
    listed: Sequence[RangingMethod],
    inputs: MethodInputs,
    context: MethodContext,
    *,
    chosen: Collection[str],
) -> dict[str, MethodColumn]:
    """Columns of the chosen ones of the listed methods, with new rangers for each sequence.

    `context` is that of all sequences, of which each has its own camera and pair. Raises
    LabelledImageError: a sequence lacks images of labelled frames, or they have another size;
    MethodError: a chosen method cannot measure with these inputs.
    """
    columns = {
        method.name: replace(unmeasured(len(boxes)), is_fallback=np.ones(len(boxes), np.bool_))
        for method in listed
    }
    reads = {method.name: method.reads for method in listed}
    of_rig = [method.name for method in listed if method.has_rig_scale]
    n_frames, n_done = sum(1 for _ in frame_rows(boxes)), 0
    with inputs.progress("frames") as advance:
        for number, name in enumerate(boxes.sequence_names):
            rows = np.flatnonzero(boxes.sequence == number)
            with ExitStack() as stack:
                frames, context = _opened(boxes.select(rows), name, inputs, context, stack)
                rangers = create_rangers(context, listed)
                for ranger in rangers.values():
                    stack.callback(ranger.close)
                _check_created(chosen, rangers)
                sequence = SequenceRangers(rangers, reads, _check(context, inputs), of_rig)
                for of_frame, tracks, frame in frames:
                    for method, ranges in sequence.measure(tracks, frame, {}).items():
                        store(columns[method], rows[of_frame], ranges)
                    n_done += 1
                    advance(n_done, n_frames)
    return {name: without_empty_systematic(columns[name]) for name in chosen}


def _check(context: MethodContext, inputs: MethodInputs) -> ScaleCheck | None:
    """The evidence of a drive that corrects the distances of networks; None without networks."""
    if not inputs.networks:
        return None
    rig = context.rig
    priors = camera_priors(
        context.camera.fx_px,
        baseline_m=None if rig is None else rig.baseline_m,
        height_m=context.camera_height_m,
        region=context.region,
    )
    return ScaleCheck(context.camera, priors, rig=rig)


def _check_created(chosen: Collection[str], rangers: Collection[str]) -> None:
    """MethodError: a chosen method has no ranger."""
    for name in chosen:
        if name not in rangers:
            raise MethodError(
                f"ranging method {name!r}: expected the input that it measures with, as of "
                "--depth-model or --stereo-model, found none."
            )


def _opened(
    boxes: BoxSet, name: str, inputs: MethodInputs, context: MethodContext, stack: ExitStack
) -> tuple[Iterator[tuple[IntArray, Tracks, Frame]], MethodContext]:
    """Rows, tracks and frames of one sequence in order of time, and its context."""
    frames = ((rows, tracks, blank) for rows, tracks, blank, _ in as_frames(boxes, boxes.class_id))
    if inputs.images is None:
        return frames, replace(context, camera=boxes.camera_at(0), rig=None)
    if (boxes.track_id < 0).any():
        raise LabelledImageError(
            f"{name}: expected labels of sequences with images, as KITTI's tracking labels, found "
            "labels of separate images."
        )
    opened = stack.enter_context(inputs.images.opened(name))
    context = replace(context, camera=opened.camera, rig=opened.rig)
    return _with_images(frames, opened), context


def _with_images(
    frames: Iterator[tuple[IntArray, Tracks, Frame]], opened: OpenedSequence
) -> Iterator[tuple[IntArray, Tracks, Frame]]:
    """The frames with their images, without the images between them."""
    for rows, tracks, blank in frames:
        shown = next((frame for frame in opened.frames if frame.index >= blank.index), None)
        if shown is None or shown.index != blank.index:
            raise LabelledImageError(
                f"{opened.source}: expected an image of the labelled frame "
                f"{blank.index}, found none."
            )
        given_hw, label_hw = shown.left.shape[:2], blank.left.shape[:2]
        if np.any(np.abs(np.divide(given_hw, label_hw) - 1) > _MAX_SIZE_DIFFERENCE):
            raise LabelledImageError(
                f"{opened.source}: expected images of the labels, of about "
                f"{label_hw[1]}x{label_hw[0]} px, found {given_hw[1]}x{given_hw[0]} px."
            )
        yield rows, tracks, replace(shown, time_s=blank.time_s)
