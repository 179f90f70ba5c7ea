"""The commands `train` and `anchors` on drawn scenes."""

import json

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
def test_eight_images_are_learnt_by_heart_and_found_again_by_the_export(drawn, tmp_path, cli):
    folder, data = drawn
    out = tmp_path / "run"
    status, told, _ = cli(
        "train", "--data", data, "--size", 160, "--epochs", 240, "--batch", 4, "--validate-every", 60, "--out", out,
        "--gain", 0.9, 1.1, "--mosaic", 0.0, "--precision", "float32", "--licence", "Apache-2.0",
    )  # fmt: skip
    assert status == 0, told
    assert "epoch 240/240: AP50" in told
    names = sorted(path.name for path in out.iterdir())
    assert names == ["best.pt", "curves.png", "last.pt", "results.csv", "yolov5n.onnx"]
    figures = tmp_path / "figures.json"
    status, told, _ = cli(
        "evaluate", "detections", "--model", out / "yolov5n.onnx", "--images", folder / "images/train",
        "--labels", folder / "labels/train", "--label-names", "car,person", "--json", figures,
    )  # fmt: skip
    assert status == 0, told
    model = json.loads(figures.read_text())["models"]["yolov5n"]
    assert model["input"] == "160 open"  # the size that it was trained at, told by its metadata
    assert min(model["classes"][name]["ap50"] for name in ("car", "person")) > 0.95


@pytest.mark.train
def test_a_run_is_not_overwritten_and_can_be_resumed(drawn, tmp_path, cli):
    _, data = drawn
    assert train(cli, data, tmp_path, "--epochs", 1, "--attention", "cbam", "--anchors", "kmeans++")[0] == 0
    status, _, complaint = train(cli, data, tmp_path, "--epochs", 1)
    assert (status, "a run is there already: continue it with --resume" in complaint) == (1, True)
    status, _, complaint = train(cli, data, tmp_path, "--epochs", 1, "--resume")
    assert (status, "attention is True there and False here" in complaint) == (1, True)
    status, told, _ = train(
        cli, data, tmp_path, "--epochs", 1, "--resume", "--attention", "cbam", "--anchors", "kmeans++"
    )
    assert status == 0
    assert "Going on after epoch 1 of 1." in told


@pytest.mark.train
def test_yolov4_tiny_with_everything_is_trained_and_used(drawn, tmp_path, cli):
    _, data = drawn
    status, told, _ = train(
        cli, data, tmp_path, "--model", "yolov4-tiny", "--epochs", 1, "--attention", "cbam", "--box-loss", "eiou",
        "--anchors", "kmeans++", "--optimiser", "sgd",
    )  # fmt: skip
    assert status == 0
    assert "Anchors: " in told
    status, told, _ = cli("models", "info", tmp_path / "yolov4-tiny.onnx")
    assert status == 0
    assert "YOLOv4-tiny" in told
    assert "car, person" in told


@pytest.mark.train
def test_a_teacher_and_a_start(drawn, tmp_path, cli):
    _, data = drawn
    assert train(cli, data, tmp_path / "first", "--epochs", 1)[0] == 0
    model, start = tmp_path / "first/yolov5n.onnx", tmp_path / "first/best.pt"
    status, _, complaint = train(cli, data, tmp_path / "second", "--epochs", 1, "--teacher", model, "--weights", start)
    assert (status, complaint) == (0, "")
    status, _, complaint = train(cli, data, tmp_path / "third", "--teacher", "no_such_model")
    assert (status, "no_such_model" in complaint) == (1, True)


def test_anchors_are_told_with_how_well_they_fit(drawn, cli):
    _, data = drawn
    status, told, _ = cli("anchors", "--data", data, "--size", 160, "--clusters", 2)
    lines = told.splitlines()
    assert status == 0
    assert "mean best IoU with YOLOv5n's own 9 anchors" in lines[0]
    assert "mean best IoU with these 2" in lines[-2]
    (w1, h1), (w2, h2) = (map(float, pair.split(",")) for pair in lines[-1].split())
    assert (w1 < h1, w2 > h2) == (True, True)  # people are tall, cars are wide
    told = cli("anchors", "--data", data, "--size", 160, "--clusters", 6)[1]
    assert [len(head.split()) for head in told.splitlines()[-1].split(" / ")] == [3, 3]  # as --anchors takes them
    status, _, complaint = cli("anchors", "--data", data, "--clusters", 32)
    assert (status, "32 anchors require" in complaint) == (1, True)


def test_wrong_data_is_one_sentence(drawn, tmp_path, cli):
    _, data = drawn
    wrong = tmp_path / "data.yaml"
    wrong.write_text(yaml.safe_dump(yaml.safe_load(data.read_text()) | {"path": str(tmp_path)}))
    status, _, complaint = train(cli, wrong, tmp_path / "run")
    assert status == 1
    assert complaint.count("\n") == 1
    assert "expected a folder" in complaint


def test_without_pytorch_it_says_what_to_install(drawn, tmp_path, cli, monkeypatch):
    _, data = drawn
    monkeypatch.setattr("track_range.detection.training.requirements.find_spec", lambda name: None)
    status, _, complaint = train(cli, data, tmp_path / "run")
    assert (status, "pip install 'track-range[train]'" in complaint) == (1, True)


@pytest.mark.train
def test_a_gpu_that_is_not_there_is_told_in_one_line(drawn, tmp_path, cli, monkeypatch):
    _, data = drawn
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    status, told, _ = train(cli, data, tmp_path / "run", "--epochs", 1, "--device", "cuda")
    assert (status, "--device cuda is not available" in told) == (0, True)
    status, _, complaint = train(cli, data, tmp_path / "other", "--device", "abacus")
    assert (status, "--device: expected auto" in complaint) == (1, True)


def test_damaged_images_are_counted_and_the_rest_is_learnt(tmp_path, cli):
    data = write_data_set(tmp_path, n_train=5, n_val=2)
    (tmp_path / "images/train/001.png").write_bytes(b"junk")
    status, told, _ = train(cli, data, tmp_path / "run", "--epochs", 1)
    assert status == 0
    assert "1 images left out:" in told
    assert "001.png: not an image" in told
    assert "4 images to learn from" in told


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--size", 100), "--size: expected a multiple of 32"),
        (("--gain", 2, 1), "--gain: expected 0.05 <= MIN <= MAX <= 16"),
        (("--gain", 0, 1), "got 0 1"),
        (("--gain", 1, "nan"), "got 1 nan"),
    ],
)
def test_settings_that_cannot_be_are_told_before_anything_is_read(drawn, tmp_path, cli, options, said):
    _, data = drawn
    status, _, complaint = cli("train", "--data", data, "--out", tmp_path / "run", *options)
    assert (status, said in complaint) == (1, True)
