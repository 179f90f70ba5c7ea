"""Random labelled images, and the figures of pycocotools for them."""

import contextlib
import io
import warnings

import numpy as np

from track_range.detection.detections import Detections
from track_range.detection.evaluation.matching import ANY_SIZE
from track_range.detection.formats.image_labels.image_truth import ImageTruth


def random_scene(rng, *, n_images, n_classes=3, scale=1.0):
    """Detections and truth of images with up to 12 labels of 5 to 30 px times `scale`."""
    detections, truth = [], []
    for _ in range(n_images):
        n = rng.integers(0, 12)
        boxes = np.concatenate(
            [xy := rng.integers(0, 40, (n, 2)), xy + rng.integers(5, 30, (n, 2))], axis=1
        )
        kind = rng.choice(3, n, p=[0.7, 0.15, 0.15])
        classes = rng.integers(0, n_classes, n)
        truth.append(
            ImageTruth.of(scale * boxes, classes, is_ignored=kind == 1, is_region=kind == 2)
        )
        near = np.repeat(boxes, 2, axis=0) + rng.integers(-4, 5, (2 * n, 4))
        near = near[(near[:, 2] > near[:, 0]) & (near[:, 3] > near[:, 1])]
        score = rng.integers(1, 20, len(near)) / 20  # with ties
        detections.append(Detections.of(scale * near, score, rng.integers(0, n_classes, len(near))))
    return detections, truth


def coco_figures(detections, truth, class_id, bins=(ANY_SIZE,)):
    """AP50-95, AP50 and recall at IoU 0.5 of one class in each bin, by pycocotools; NaN without
    labels.

    Ignored labels that are not regions have a size out of range. For bins of height, the areas are
    replaced by heights.
    """
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        from pycocotools.coco import COCO
        from pycocotools.cocoeval import COCOeval

        labels, results = [], []
        for image, (f, t) in enumerate(zip(detections, truth, strict=True), start=1):
            for j in np.flatnonzero(t.class_id == class_id):
                label = {
                    "id": len(labels) + 1,
                    "image_id": image,
                    "category_id": 1,
                    "bbox": _xywh(t.xyxy_px[j]),
                }
                size = (
                    1e12
                    if t.is_ignored[j] and not t.is_region[j]
                    else _size(label["bbox"], bins[0].measure)
                )
                labels.append({**label, "area": size, "iscrowd": int(t.is_region[j])})
            for j in np.flatnonzero(f.class_id == class_id):
                row = {
                    "image_id": image,
                    "category_id": 1,
                    "bbox": _xywh(f.xyxy_px[j]),
                    "score": float(f.score[j]),
                }
                results.append(row)
        coco = COCO()
        images = [{"id": i + 1} for i in range(len(truth))]
        coco.dataset = {
            "images": images,
            "annotations": labels,
            "categories": [{"id": 1}],
            "info": {},
        }
        coco.createIndex()
        found = coco.loadRes(results)
        for row in found.anns.values():
            row["area"] = _size(row["bbox"], bins[0].measure)
        evaluator = COCOeval(coco, found, "bbox")
        evaluator.params.areaRng = [[one.low, min(one.high, 1e10)] for one in bins]
        evaluator.params.areaRngLbl = [one.name for one in bins]
        evaluator.evaluate()
        evaluator.accumulate()
    figures = []
    for i in range(len(bins)):
        precision, recall = (
            evaluator.eval["precision"][:, :, 0, i, 2],
            evaluator.eval["recall"][0, 0, i, 2],
        )
        row = (precision.mean(), precision[0].mean(), recall)
        figures.append(tuple(np.nan if value == -1 else value for value in row))
    return figures


def _xywh(xyxy_px):
    x1, y1, x2, y2 = xyxy_px.tolist()
    return [x1, y1, x2 - x1, y2 - y1]


def _size(xywh_px, measure):
    return xywh_px[2] * xywh_px[3] if measure == "area" else xywh_px[3]
