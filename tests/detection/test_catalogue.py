"""The catalogue of models, the folder of downloaded models, and the lookup of models by name."""

import re
import sys
from pathlib import Path

import pytest

from track_range.detection.catalogue.entries import CATALOGUE, entry_named
from track_range.detection.catalogue.lookup import find_model, model_rows, models_folder
from track_range.detection.models.onnx_session import ModelError

DIGITS = {"sha1": 40, "sha256": 64}


def test_every_entry_is_complete():
    names = [entry.name for entry in CATALOGUE]
    assert len(set(names)) == len(names)
    assert {"yolov4-tiny", "yolov5n", "yolox_nano"} <= set(names)
    for entry in CATALOGUE:
        assert len(entry.classes) in (80, 91)
        assert entry.licence.name
        assert entry.licence.meaning
        assert entry.size_bytes > 1e6
        for file in entry.files:
            assert file.url.startswith("https://")
            algorithm, digest = file.checksum.split(":")
            assert re.fullmatch(rf"[0-9a-f]{{{DIGITS[algorithm]}}}", digest)
        suffixes = {Path(file.name).suffix for file in entry.files}
        assert suffixes == ({".cfg", ".weights"} if entry.is_darknet else {".onnx"})
        assert entry.is_darknet or entry.files[0].name == f"{entry.name}.onnx"


def test_notice_explains_copyleft_licence():
    notice = entry_named("yolov5n").notice
    assert "AGPL-3.0: GNU Affero General Public License" in notice
    assert "4.0 MB from ultralytics/yolov5" in notice


@pytest.mark.parametrize("name", ["YOLOv4-Tiny", "yolov4_tiny", " yolov4-tiny "])
def test_name_spelling_variants(name):
    assert entry_named(name).name == "yolov4-tiny"


def test_models_folder(monkeypatch):
    monkeypatch.setenv("TRACK_RANGE_CACHE", "/c")
    assert models_folder() == Path("/c/models")
    monkeypatch.delenv("TRACK_RANGE_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/x")
    if sys.platform == "linux":
        assert models_folder() == Path("/x/track-range/models")
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert models_folder().is_absolute()
    assert models_folder().parts[-2:] == ("track-range", "models")


def test_models_folder_without_home(monkeypatch):
    monkeypatch.setattr("os.path.expanduser", lambda path: path)
    for name in ("TRACK_RANGE_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ModelError, match="set TRACK_RANGE_CACHE"):
        models_folder()


@pytest.fixture
def model_folders(tmp_path):
    """Arguments of `find_model`: a packaged and a cache folder."""
    folders = {"packaged": tmp_path / "packaged", "cache": tmp_path / "cache"}
    for folder in folders.values():
        folder.mkdir()
    return folders


def test_lookup_order_of_models(model_folders, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find_model("yolov5n", **model_folders).origin == "catalogue"
    assert find_model("yolov5n", **model_folders).path == model_folders["cache"] / "yolov5n.onnx"
    for folder, origin in (
        (model_folders["cache"], "cached"),
        (model_folders["packaged"], "packaged"),
        (tmp_path, "file"),
    ):
        (folder / "yolov5n.onnx").touch()
        name = "yolov5n.onnx" if origin == "file" else "YOLOv5n"
        model = find_model(name, **model_folders)
        assert (model.origin, model.path.resolve()) == (origin, folder / "yolov5n.onnx")
    (model_folders["cache"] / "custom.onnx").touch()
    assert find_model("custom", **model_folders).origin == "cached"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("none/yolov5n", "none/yolov5n: no such"),
        ("none.onnx", r"none\.onnx: no such"),
        ("yolov5m", "yolov5m: .*did you mean yolov5n"),
        ("resnet", "resnet: .*yolov4-tiny"),
    ],
)
def test_unknown_models(model_folders, name, message):
    with pytest.raises(ModelError, match=message):
        find_model(name, **model_folders)


def test_list_of_models(model_folders):
    (model_folders["packaged"] / "road.onnx").touch()
    for name in ("yolov5n", "custom"):
        (model_folders["cache"] / f"{name}.onnx").touch()
    rows = {row.name: row for row in model_rows(**model_folders)}
    assert rows["road"].state == "packaged"
    assert (rows["yolov5n"].state, rows["yolov4-tiny"].state) == ("downloaded", "not downloaded")
    assert rows["custom"].state == "in the cache folder"
    assert rows["yolov5n"].licence == "AGPL-3.0"
    assert rows["yolov4-tiny"].size == "24.3 MB"
