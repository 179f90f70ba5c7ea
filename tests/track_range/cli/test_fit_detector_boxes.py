"""`track-range fit --detector-boxes`: errors of a detector's boxes, measured on labelled images."""

import cv2
import numpy as np
import pytest
import yaml

from tests.support.networks.onnx_models import write_model
from track_range.detection.box_errors import UNKNOWN_DETECTOR
from track_range.detection.detections import Detections
from track_range.detection.evaluation.box_error_fit import BoxErrorSamples
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.detection.yolo.detector import YoloDetector

CAR = 2
TRUE_PX = np.array([108.0, 108.0, 188.0, 152.0])


def samples_of(boxes, labels=TRUE_PX, *, n=30, score=0.9, **truth):
    samples = BoxErrorSamples()
    for box in np.broadcast_to(boxes, (n, 4)):
        true = ImageTruth.of(labels, np.full(len(np.reshape(labels, (-1, 4))), CAR), **truth)
        samples.add((300, 300), Detections.of([box], [score], [CAR]), true)
    return samples


def test_boxes_that_are_a_tenth_too_low_and_exact_in_width():
    low = TRUE_PX.copy()
    low[3] = 108 + 0.9 * 44
    error, n = samples_of(low).fit(is_drawn=False)["car"]
    assert n == 30
    assert error == pytest.approx((np.log(0.9), 0.04, 0.0, 0.04), abs=1e-3)
    drawn, _ = samples_of(low).fit(is_drawn=True)["car"]
    assert drawn.log_height_sigma > error.log_height_sigma


def test_few_noisy_images_say_little():
    """The mean is drawn to that of an unknown detector, and sigma stays near its sigma."""
    noise_px = np.random.default_rng(0).normal(0.0, 6.0, 24)
    boxes = TRUE_PX + np.array([0, 0, 0, 1]) * (noise_px - 6)[:, None]
    error, _ = samples_of(boxes, n=24).fit(is_drawn=False)["car"]
    plain = np.median(np.log((boxes[:, 3] - 108) / 44))
    assert 1.1 * abs(error.log_height) < abs(plain)
    assert 0.041 < error.log_height_sigma < UNKNOWN_DETECTOR["car"].log_height_sigma


@pytest.mark.parametrize(
    "arguments",
    [
        # the other one is nearer and covers it
        {"labels": TRUE_PX + np.array([[0, 0, 0, 0], [20, 0, 20, 30]])},
        {"labels": TRUE_PX, "is_ignored": True},
        {"labels": TRUE_PX, "score": 0.2},
        {"labels": TRUE_PX, "n": 19},
        # cut at the top
        {"labels": np.array([108.0, 0.5, 188, 44.5]), "boxes": np.array([108.0, 0.5, 188, 44.5])},
        # 22 px high
        {"labels": np.array([108.0, 108, 150, 130]), "boxes": np.array([108.0, 108, 150, 130])},
    ],
)
def test_labels_that_are_not_used(arguments):
    assert samples_of(**{"boxes": TRUE_PX, **arguments}).fit(is_drawn=False) == {}


@pytest.fixture
def scene(tmp_path):
    """30 images of 64 x 64 px with a car of 44 px; a NanoDet whose box of it is 40 px high and
    wide."""
    for name in ("images", "labels"):
        (tmp_path / name).mkdir()
    for i in range(30):
        cv2.imwrite(str(tmp_path / f"images/{i:03}.png"), np.full((64, 64, 3), 90, np.uint8))
        (tmp_path / f"labels/{i:03}.txt").write_text("2 0.4453 0.4766 0.625 0.6875\n")
    outputs = []
    for stride in (8, 16, 32):
        n = (64 // stride) ** 2
        scores, bins = np.zeros((1, n, 1)), np.zeros((1, n, 32))
        if stride == 8:
            scores[0, 3 * 8 + 3] = 0.6  # centre (28, 28)
            bins.reshape(1, n, 4, 8)[:, :, :, 2:4] = 9.0  # 20 px to every side
        outputs += [scores, bins]
    write_model(tmp_path / "nano.onnx", *outputs)
    (tmp_path / "nano.yaml").write_text("names: [car]\nbox_errors: {bus: [0, 0.1, 0, 0.1]}\n")
    return tmp_path


def test_values_are_written_beside_the_model_and_used(scene, cli):
    given = ("--images", scene / "images", "--labels", scene / "labels")
    status, printed, errors = cli("fit", "--detector-boxes", scene / "nano.onnx", *given)
    assert (status, errors) == (0, ""), errors
    assert "Systematic errors of the boxes" in printed
    assert "30" in printed
    written = yaml.safe_load((scene / "nano.yaml").read_text())
    assert written["names"] == ["car"]
    assert set(written["box_errors"]) == {"bus", "car"}
    error = YoloDetector(scene / "nano.onnx").box_errors["car"]
    assert error.log_height == pytest.approx(np.log(40 / 44), abs=0.003)
    assert error.log_width == pytest.approx(0.0, abs=0.003)


def test_errors_say_what_to_do(scene, cli):
    model, given = scene / "nano.onnx", ("--images", scene / "images", "--labels", scene / "labels")
    for i in range(12):
        (scene / f"images/{i:03}.png").unlink()
    for options, status, words in (
        (("--detector-boxes", model, *given), 1, ("at least 20 labels", "18 images", "--format")),
        (("--detector-boxes", model, "--labels", scene / "labels"), 2, ("--images",)),
        (("--detector-boxes", "road", *given), 2, ("packaged", "--out")),
        (("--detector-boxes", scene / "none.onnx", *given), 1, ("none.onnx", "no such model")),
        (
            ("--detector-boxes", model, *given, "--out", scene / "list.yaml"),
            1,
            ("list.yaml", "--out"),
        ),
        (
            ("--detector-boxes", model, *given, "--out", scene / "text.yaml"),
            1,
            ("text.yaml", "--out"),
        ),
    ):
        (scene / "list.yaml").write_text("- car\n")
        (scene / "text.yaml").write_text("box_errors: unknown\n")
        actual, _, errors = cli("fit", *options)
        assert actual == status, errors
        assert all(word in " ".join(errors.split()) for word in words), errors
