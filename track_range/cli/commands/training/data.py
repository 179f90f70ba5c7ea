"""Reading of images and fitting of anchors for `track-range train` and `track-range anchors`."""

from collections.abc import Sequence

import numpy as np

from track_range.cli.commands.training.options import AnchorOptions
from track_range.cli.shared.console import console, print_first, print_line
from track_range.detection.formats.image_labels.labelled_images import LabelledImage
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.training.data.data_set import CachedImages
from track_range.detection.training.data_yaml import TrainingData, read_data_yaml
from track_range.detection.training.errors import TrainingError
from track_range.detection.training.networks.registry import (
    NETWORKS,
    as_text,
    by_head,
    kmeans_anchors,
    mean_best_iou,
)
from track_range.detection.yolo.metadata import Anchors
from track_range.foundation.arrays import FloatArray
from track_range.run.progress import step_progress

_N_PER_HEAD = 3  # number of anchors of each head, in all networks


def print_anchors(options: AnchorOptions) -> None:
    """Print k-means++ anchors of the training boxes of a data set, and the mean best IoU of these
    and the defaults.
    """
    size_px, n_anchors = options.size_px, options.clusters
    data = read_data_yaml(options.data)
    print_line(console, *data.notes)
    sizes = read_images(data.train, data, max_side_px=size_px).box_sizes_px(size_px)
    if not len(sizes):
        raise LabelFileError(
            f"{options.data}: expected labelled objects in the training images, found none."
        )
    for kind in (kind for kind in NETWORKS.values() if kind.anchors_px):
        default = np.array(kind.anchors_px, np.float64).reshape(-1, 2)
        print_line(
            console,
            f"{mean_best_iou(sizes, default):.3f} mean best IoU with {len(default)} default "
            f"anchors of {kind.family}",
        )
    fitted = _kmeans(sizes, n_anchors, options.seed)
    print_line(
        console,
        f"{mean_best_iou(sizes, fitted):.3f} mean best IoU with {n_anchors} anchors fitted to "
        f"{len(sizes)} boxes:",
    )
    n_heads = n_anchors // _N_PER_HEAD if n_anchors % _N_PER_HEAD == 0 else 1
    print_line(console, as_text(by_head(fitted, n_heads)))


def read_images(
    items: Sequence[LabelledImage], data: TrainingData, *, max_side_px: int | None
) -> CachedImages:
    """Images of a data set; unreadable images are listed and skipped. ImageFileError if all are
    unreadable.
    """
    with step_progress(console, "reading images") as progress:
        images = CachedImages(items, data.road_class_id, max_side_px=max_side_px, progress=progress)
    print_first(
        console,
        f"{len(images.unreadable)} images cannot be read and are skipped:",
        images.unreadable,
    )
    return images


def fitted_anchors(images: CachedImages, model: str, size_px: int, seed: int) -> Anchors:
    """K-means++ anchors of the training boxes, as many as the network has; TrainingError if it has
    none.
    """
    kind = NETWORKS[model]
    if not kind.anchors_px:
        raise TrainingError(
            f"--anchors kmeans++: expected a --model with anchors, got {model}, which has none."
        )
    sizes = images.box_sizes_px(size_px)
    fitted = _kmeans(sizes, kind.n_anchors, seed)
    default_iou = mean_best_iou(sizes, np.array(kind.anchors_px, np.float64).reshape(-1, 2))
    anchors = by_head(fitted, kind.n_heads)
    print_line(
        console,
        f"Anchors: {as_text(anchors)}; mean best IoU {mean_best_iou(sizes, fitted):.3f} (default "
        f"anchors: {default_iou:.3f}).",
    )
    return anchors


def _kmeans(sizes: FloatArray, n_anchors: int, seed: int) -> FloatArray:
    try:
        return kmeans_anchors(sizes, n_anchors, np.random.default_rng(seed))
    except ValueError as error:
        raise LabelFileError(f"{error}") from error
