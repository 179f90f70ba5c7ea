"""Tests of `evaluate detections` and `models quantize` on synthetic networks and images."""

import json

import cv2
import numpy as np
import pytest

from tests.support.networks.onnx_models import write_model, write_rectangle_finder
from track_range.detection.yolo.detector import YoloDetector
from track_range.evaluation.sequences.detector_evaluation import (
    Candidate,
    evaluate as evaluate_frames,
)
from track_range.evaluation.sequences.labelled_images import LabelledSource

GREY = 114


@pytest.fixture
def rectangles(tmp_path):
    """Ten images of 96 x 96 px with one bright rectangle each, labelled as a car, and a network
    that detects it."""
    rng = np.random.default_rng(0)
    for name in ("images", "labels"):
        (tmp_path / name).mkdir()
    for i in range(10):
        (x1, y1), (w, h) = rng.integers(4, 40, 2), rng.integers(12, 50, 2)
        image = np.full((96, 96, 3), GREY, np.uint8)
        image[y1 : y1 + h, x1 : x1 + w] = 255
        cv2.imwrite(str(tmp_path / f"images/{i}.png"), image)
        fraction = np.array([x1 + w / 2, y1 + h / 2, w, h]) / 96
        (tmp_path / f"labels/{i}.txt").write_text(f"2 {' '.join(map(str, fraction))}\n")
    metadata = {"names": '["car"]'}
    write_rectangle_finder(tmp_path / "finder.onnx", side_px=96, grey=GREY / 255, metadata=metadata)
    return tmp_path


def evaluate(cli, folder, *more):
    inputs = [
        "--images",
        folder / "images",
        "--labels",
        folder / "labels",
        "--json",
        folder / "figures.json",
    ]
    status, printed, errors = cli("evaluate", "detections", *inputs, *more)
    assert status == 0, errors
    return json.loads((folder / "figures.json").read_text()), printed


def test_perfect_and_blind_detector(rectangles, cli):
    blind = write_model(
        rectangles / "blind.onnx", np.zeros((1, 252, 6)), metadata={"names": "['car']"}
    )
    figures, printed = evaluate(
        cli, rectangles, "--model", rectangles / "finder.onnx", "--model", blind
    )
    finder, blind = figures["models"]["finder"], figures["models"]["blind"]
    car = finder["classes"]["car"]
    assert (car["n_images"], car["n_boxes"], car["ap50"], car["ap50_95"]) == (10, 10, 1.0, 1.0)
    assert (car["precision"], car["recall"], car["is_averaged"]) == (1, 1, False)
    assert blind["classes"]["car"]["recall"] == 0
    assert finder["ap50"] is None  # ten boxes are too few for a mean
    assert figures["n_images"] == 10
    assert finder["speed"]["fps"] > 0
    for word in ("car (10)", "AP50", "finder", "blind"):
        assert word in printed


def test_sizes_and_calibration(rectangles, cli):
    blind = write_model(
        rectangles / "blind.onnx", np.zeros((1, 252, 6)), metadata={"names": "['car']"}
    )
    model = ("--model", rectangles / "finder.onnx")
    figures, printed = evaluate(cli, rectangles, *model, "--figure", rectangles / "f.svg")
    finder = figures["models"]["finder"]
    for bins in finder["by_size"].values():
        counts = [row["classes"]["car"]["n_boxes"] for row in bins]
        assert sum(counts) == 10
        assert [row["classes"]["car"]["ap50"] for row in bins] == [
            1.0 if n else None for n in counts
        ]
    row = finder["calibration"]["classes"]["car"]
    assert (row["n"], row["precision"]) == (10, 1.0)
    assert row["ece"] == pytest.approx(1 - row["mean_score"])
    for text in ("car, small", "car, medium", "by area", "ECE", "f.svg"):
        assert text in printed
    assert "<svg" in (rectangles / "f.svg").read_text()

    both = (*model, "--model", blind)
    figures, printed = evaluate(
        cli, rectangles, *both, "--by", "height", "--figure", rectangles / "f.png"
    )
    assert figures["models"]["blind"]["calibration"]["all"]["ece"] is None
    assert figures["models"]["blind"]["by_size"]["height"][1]["classes"]["car"]["recall"] == 0.0
    for text in ("car, < 25 px", "finder: by height", "blind: by height", "ECE % by class"):
        assert text in printed
    assert (rectangles / "f.png").read_bytes().startswith(b"\x89PNG")


def test_input_of_a_model_with_an_area(rectangles, cli):
    rows, metadata = np.zeros((1, 252, 6)), {"names": "['car']"}
    write_model(
        rectangles / "side.onnx",
        rows,
        metadata=metadata | {"size": "64"},
        input_shape=(1, 3, "h", "w"),
    )
    write_model(
        rectangles / "area.onnx",
        rows,
        metadata=metadata | {"area": "4096"},
        input_shape=(1, 3, "h", "w"),
    )
    models = ("--model", rectangles / "side.onnx", "--model", rectangles / "area.onnx")
    figures, printed = evaluate(cli, rectangles, *models)
    assert [row["input"] for row in figures["models"].values()] == ["64 open", "4096 px2 open"]
    assert "4096 px2 open" in printed
    figures, _ = evaluate(cli, rectangles, *models, "--size", 64)
    assert [row["input"] for row in figures["models"].values()] == ["64 open"] * 2


@pytest.mark.parametrize(
    ("option", "status", "message"),
    [
        (("--figure", "f.txt"), 2, ".svg or .png"),
        (("--figure", "no/such/folder/f.svg"), 1, "cannot be written"),
        (("--json", "no/such/folder/f.json"), 1, "cannot be written"),
        (("--by", "width"), 2, "--by"),
    ],
)
def test_outputs_are_checked_before_models_are_loaded(rectangles, cli, option, status, message):
    actual, _, errors = cli(
        "evaluate", "detections", "--model", "missing.onnx", *option,
        "--images", rectangles / "images", "--labels", rectangles / "labels",
    )  # fmt: skip
    assert (actual, message in errors, "missing.onnx" in errors) == (status, True, False), errors


def test_manifest_unknown_class_and_damaged_image(rectangles, cli):
    lines = [
        f"{i}.png,{'val' if i < 4 else 'train'},{'00100000' if i else '00000000'}"
        for i in range(10)
    ]
    (rectangles / "m.csv").write_text("file,split,labels_complete\n" + "\n".join(lines))
    (rectangles / "images/3.png").write_bytes(b"damaged")
    (rectangles / "labels/1.txt").write_text("2 0.5 0.5 0.2 0.2\n")
    person = write_model(
        rectangles / "p.onnx", np.zeros((1, 252, 6)), metadata={"names": "['person']"}
    )
    models = ["--model", rectangles / "finder.onnx", "--model", person]
    figures, printed = evaluate(cli, rectangles, *models, "--manifest", rectangles / "m.csv")
    assert figures["n_images"] == 3
    # in image 0 not all cars are labelled
    assert figures["models"]["finder"]["classes"]["car"]["n_images"] == 2
    assert "p does not detect car" in printed
    assert "Skipped 1 image;" in printed.replace("\n", " ")
    status, _, errors = cli(
        "evaluate",
        "detections",
        *models,
        "--images",
        rectangles / "images",
        "--labels",
        rectangles / "labels",
        "--manifest",
        rectangles / "m.csv",
        "--split",
        "test",
    )
    assert (status, "m.csv" in errors, "split 'test'" in errors) == (1, True, True)


def test_classes_and_working_scores(rectangles, cli):
    figures, _ = evaluate(
        cli, rectangles, "--model", rectangles / "finder.onnx", "--min-score", "0.2,car=1.0"
    )
    assert (figures["working_score"]["car"], figures["working_score"]["bus"]) == (1.0, 0.2)
    figures, _ = evaluate(
        cli, rectangles, "--model", rectangles / "finder.onnx", "--classes", "bus,truck"
    )
    assert figures["models"]["finder"]["classes"] == {}  # cars are ignored
    status, _, errors = cli(
        "evaluate", "detections", "--model", rectangles / "finder.onnx", "--classes", "tuck",
        "--images", rectangles / "images", "--labels", rectangles / "labels",
    )  # fmt: skip
    assert (status, "truck" in errors) == (1, True)


def test_frames_of_a_video_with_kitti_labels(shared_data, cli, tmp_path):
    drive = shared_data / "kitti_stereo/0003"
    status, _, errors = cli(
        "evaluate", "detections", "--model", shared_data / "models/yolov5n_coco_dyn.onnx",
        "--images", drive / "left.mp4", "--labels", drive / "label.txt", "--json", tmp_path / "f.json",
    )  # fmt: skip
    assert status == 0, errors
    car = json.loads((tmp_path / "f.json").read_text())["models"]["yolov5n_coco_dyn"]["classes"][
        "car"
    ]
    assert car["n_images"] == 16
    assert 0.5 < car["ap50"] < 1.0  # near cars, and two occluded ones


def test_video_needs_a_kitti_tracking_file(shared_data, cli, tmp_path):
    status, _, errors = cli(
        "evaluate", "detections", "--model", shared_data / "models/yolov5n_coco_dyn.onnx",
        "--images", shared_data / "kitti_stereo/0003/left.mp4", "--labels", tmp_path,
    )  # fmt: skip
    assert (status, "KITTI tracking" in errors) == (2, True)


def test_no_image_can_be_read(rectangles, cli):
    for image in (rectangles / "images").iterdir():
        image.write_bytes(b"damaged")
    status, _, errors = cli(
        "evaluate", "detections", "--model", rectangles / "finder.onnx",
        "--images", rectangles / "images", "--labels", rectangles / "labels",
    )  # fmt: skip
    assert (status, "read" in errors) == (1, True)


def test_quantize_writes_smaller_copies(shared_data, cli, tmp_path):
    images = tmp_path / "images"
    images.mkdir()
    capture = cv2.VideoCapture(str(shared_data / "kitti_stereo/0005/left.mp4"))
    for i in range(10):
        cv2.imwrite(str(images / f"{i}.jpg"), capture.read()[1][:, 300:900])
    model, figures = shared_data / "models/yolox_nano_416.onnx", tmp_path / "f.json"
    status, printed, errors = cli(
        "models", "quantize", model, "--images", images, "--out", tmp_path, "--json", figures
    )
    assert status == 0, errors
    assert "original's boxes" in " ".join(printed.split())
    read = json.loads(figures.read_text())
    assert read["n_images"] == 5  # the other five were used for calibration
    original, int8, fp16 = read["models"].values()
    assert int8["size_mb"] < 0.5 * original["size_mb"]
    assert fp16["size_mb"] < 0.6 * original["size_mb"]
    assert original["classes"]["car"]["ap50"] == pytest.approx(1.0)
    assert fp16["classes"]["car"]["ap50"] > 0.95
    assert 0.6 < int8["classes"]["car"]["ap50"] <= 1.0
    assert sorted(file.name for file in tmp_path.glob("*.onnx")) == [
        "yolox_nano_416-fp16.onnx",
        "yolox_nano_416-int8.onnx",
    ]


def test_quantize_needs_two_images(rectangles, cli):
    for image in sorted((rectangles / "images").iterdir())[1:]:
        image.unlink()
    status, _, errors = cli(
        "models", "quantize", rectangles / "finder.onnx", "--images", rectangles / "images"
    )
    assert (status, "at least 2 images" in errors) == (1, True)


def test_figures_after_an_interrupt(rectangles):
    class InterruptedDetector(YoloDetector):
        def decode(self, outputs):
            if len(candidate.detections) == 4:
                raise KeyboardInterrupt
            return super().decode(outputs)

    candidate = Candidate("finder", InterruptedDetector(rectangles / "finder.onnx"))
    frames = LabelledSource(images=rectangles / "images", labels=rectangles / "labels").open()
    figures = evaluate_frames([candidate], frames, min_score=None)
    assert (figures["n_images"], figures["is_complete"]) == (4, False)
    assert figures["models"]["finder"]["classes"]["car"]["recall"] == 1.0
    assert any("4 images" in note for note in figures["notes"])
    candidate.detections[:] = [None] * 4  # now the first image is interrupted
    with pytest.raises(KeyboardInterrupt):
        evaluate_frames([candidate], frames, min_score=None)
