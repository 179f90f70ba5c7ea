"""The commands `train` and `anchors` on drawn scenes."""

import json

import onnx
import pytest
import torch
import yaml

from tests.detection.training.road_scenes import write_data_set


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    torch.set_num_threads(1)  # as for tests/detection/training


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drawn")
    return folder, write_data_set(folder, n_train=8)


def train(cli, data, out, *options):
    return cli("train", "--data", data, "--out", out, "--size", 96, "--batch", 4, *options)


@pytest.mark.train
def test_overfitting_eight_images_and_export(drawn, tmp_path, cli):
    folder, data = drawn
    out = tmp_path / "run"
    status, printed, _ = cli(
        "train", "--data", data, "--size", 160, "--epochs", 240, "--batch", 4, "--validate-every", 60, "--out", out,
        "--gain", 0.9, 1.1, "--mosaic", 0.0, "--precision", "float32", "--licence", "Apache-2.0",
    )  # fmt: skip
    assert status == 0, printed
    assert "epoch 240/240: AP50" in printed
    names = sorted(path.name for path in out.iterdir())
    assert names == ["best.pt", "curves.png", "last.pt", "results.csv", "yolov5n.onnx"]
    figures = tmp_path / "figures.json"
    status, printed, _ = cli(
        "evaluate", "detections", "--model", out / "yolov5n.onnx", "--images", folder / "images/train",
        "--labels", folder / "labels/train", "--label-names", "car,person", "--json", figures,
    )  # fmt: skip
    assert status == 0, printed
    model = json.loads(figures.read_text())["models"]["yolov5n"]
    assert model["input"] == "160 open"  # the training size, from the metadata
    assert min(model["classes"][name]["ap50"] for name in ("car", "person")) > 0.95


@pytest.mark.train
def test_road_network(drawn, tmp_path, cli):
    folder, data = drawn
    status, printed, complaint = cli(
        "train", "--data", data, "--model", "road", "--size", 160, "--epochs", 150, "--batch", 4, "--out", tmp_path,
        "--validate-every", 75, "--gain", 0.9, 1.1, "--mosaic", 0.2, "--last-epochs", 100, "--precision", "float32",
    )  # fmt: skip
    assert (status, complaint) == (0, "")
    assert "RoadNet" in printed
    assert "bins" in printed
    figures = tmp_path / "figures.json"
    status, printed, _ = cli(
        "evaluate", "detections", "--model", tmp_path / "road.onnx", "--images", folder / "images/train",
        "--labels", folder / "labels/train", "--label-names", "car,person", "--json", figures,
    )  # fmt: skip
    assert status == 0, printed
    model = json.loads(figures.read_text())["models"]["road"]
    assert min(model["classes"][name]["ap50"] for name in ("car", "person")) > 0.95
    assert (
        train(cli, data, tmp_path / "anchors", "--model", "road", "--anchors", "kmeans++")[0] == 1
    )


@pytest.mark.train
def test_resume_and_no_overwriting(drawn, tmp_path, cli):
    _, data = drawn
    assert (
        train(cli, data, tmp_path, "--epochs", 1, "--attention", "cbam", "--anchors", "kmeans++")[0]
        == 0
    )
    status, _, complaint = train(cli, data, tmp_path, "--epochs", 1)
    assert (status, "--resume" in complaint) == (1, True)
    status, _, complaint = train(cli, data, tmp_path, "--epochs", 1, "--resume")
    assert (status, "attention" in complaint) == (1, True)
    status, printed, _ = train(
        cli,
        data,
        tmp_path,
        "--epochs",
        1,
        "--resume",
        "--attention",
        "cbam",
        "--anchors",
        "kmeans++",
    )
    assert status == 0
    assert "after epoch 1 of 1" in printed


@pytest.mark.train
def test_yolov4_tiny_with_all_options(drawn, tmp_path, cli):
    _, data = drawn
    status, printed, _ = train(
        cli, data, tmp_path, "--model", "yolov4-tiny", "--epochs", 1, "--attention", "cbam", "--box-loss", "eiou",
        "--anchors", "kmeans++", "--optimiser", "sgd",
    )  # fmt: skip
    assert status == 0
    assert "Anchors: " in printed
    status, printed, _ = cli("models", "info", tmp_path / "yolov4-tiny.onnx")
    assert status == 0
    assert "YOLOv4-tiny" in printed
    assert "car, person" in printed


@pytest.mark.train
def test_teacher_and_initial_weights(drawn, tmp_path, cli):
    _, data = drawn
    assert train(cli, data, tmp_path / "first", "--epochs", 1)[0] == 0
    model, start = tmp_path / "first/yolov5n.onnx", tmp_path / "first/best.pt"
    status, _, complaint = train(
        cli, data, tmp_path / "second", "--epochs", 1, "--teacher", model, "--weights", start
    )
    assert (status, complaint) == (0, "")
    both = ("--weights", start, "--weights", tmp_path / "second/last.pt", "--int8-epochs", 1)
    status, _, complaint = train(cli, data, tmp_path / "rounded", "--epochs", 1, *both)
    assert (status, complaint) == (0, "")
    nodes = onnx.load(tmp_path / "rounded/yolov5n.onnx").graph.node
    assert not [node.op_type for node in nodes if "Quantize" in node.op_type]
    status, _, complaint = train(cli, data, tmp_path / "third", "--teacher", "no_such_model")
    assert (status, "no_such_model" in complaint) == (1, True)


def test_probabilities_need_the_road_network(drawn, tmp_path, cli):
    folder, data = drawn
    (tmp_path / "teacher").mkdir()
    for image in (folder / "images/train").iterdir():
        (tmp_path / "teacher" / f"{image.stem}.txt").write_text("0 .2 .2 .1 .1 0.45\n")
    document = yaml.safe_load(data.read_text()) | {
        "path": str(folder),
        "labels_pseudo": str(tmp_path / "teacher"),
    }
    document["pseudo_scores"] = "probabilities"
    (tmp_path / "soft.yaml").write_text(yaml.safe_dump(document))
    status, _, complaint = train(cli, tmp_path / "soft.yaml", tmp_path / "run", "--epochs", 1)
    assert (
        status,
        "--model yolov5n: expected `pseudo_scores: thresholds`" in " ".join(complaint.split()),
    ) == (
        1,
        True,
    ), complaint


def test_anchors_and_their_iou(drawn, cli):
    _, data = drawn
    status, printed, _ = cli("anchors", "--data", data, "--size", 160, "--clusters", 2)
    lines = printed.splitlines()
    assert status == 0
    assert "mean best IoU" in lines[0]
    assert "mean best IoU" in lines[-2]
    (w1, h1), (w2, h2) = (map(float, pair.split(",")) for pair in lines[-1].split())
    assert (w1 < h1, w2 > h2) == (True, True)  # people are tall, cars are wide
    printed = cli("anchors", "--data", data, "--size", 160, "--clusters", 6)[1]
    # as --anchors takes them
    assert [len(head.split()) for head in printed.splitlines()[-1].split(" / ")] == [3, 3]
    status, _, complaint = cli("anchors", "--data", data, "--clusters", 32)
    assert (status, "32 anchors" in complaint) == (1, True)


def test_invalid_data(drawn, tmp_path, cli):
    _, data = drawn
    wrong = tmp_path / "data.yaml"
    wrong.write_text(yaml.safe_dump(yaml.safe_load(data.read_text()) | {"path": str(tmp_path)}))
    status, _, complaint = train(cli, wrong, tmp_path / "run")
    assert status == 1
    assert complaint.count("\n") == 1
    assert "expected a folder" in complaint


def test_without_pytorch(drawn, tmp_path, cli, monkeypatch):
    _, data = drawn
    monkeypatch.setattr("track_range.detection.training.errors.find_spec", lambda name: None)
    status, _, complaint = train(cli, data, tmp_path / "run")
    assert (status, "track-range[train]" in complaint) == (1, True)


@pytest.mark.train
def test_missing_gpu(drawn, tmp_path, cli, monkeypatch):
    _, data = drawn
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    status, printed, _ = train(cli, data, tmp_path / "run", "--epochs", 1, "--device", "cuda")
    assert (status, "cuda" in printed) == (0, True)
    status, _, complaint = train(cli, data, tmp_path / "other", "--device", "abacus")
    assert (status, "--device: expected auto" in complaint) == (1, True)


@pytest.mark.slow
def test_damaged_images_are_skipped(tmp_path, cli):
    data = write_data_set(tmp_path, n_train=5, n_val=2)
    (tmp_path / "images/train/001.png").write_bytes(b"junk")
    status, printed, _ = train(cli, data, tmp_path / "run", "--epochs", 1)
    assert status == 0
    assert "1 images" in printed
    assert "001.png: " in printed
    assert "4 training images" in printed


@pytest.mark.parametrize(
    ("options", "expected_status", "message"),
    [
        (("--size", 100), 1, "--size: expected a multiple of 32"),
        (("--gain", 2, 1), 1, "--gain: expected 0.05 <= MIN <= MAX <= 16"),
        (("--gain", 0, 1), 1, "got 0 1"),
        (("--gain", 1, "nan"), 2, "--gain: expected a finite number"),
    ],
)
def test_invalid_settings(drawn, tmp_path, cli, options, expected_status, message):
    _, data = drawn
    status, _, complaint = cli("train", "--data", data, "--out", tmp_path / "run", *options)
    assert (status, message in complaint) == (expected_status, True)
