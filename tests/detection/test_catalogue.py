"""The table of models itself, where models live, and what a word on the command line means."""

import re
from pathlib import Path

import pytest

from track_range.detection.models.catalogue import CATALOGUE, entry_named
from track_range.detection.models.lookup import find_model, model_rows, models_folder
from track_range.detection.models.onnx_session import ModelError

DIGITS = {"sha1": 40, "sha256": 64}


def test_every_entry_is_complete():
    names = [entry.name for entry in CATALOGUE]
    assert len(set(names)) == len(names)
    assert {"yolov4-tiny", "yolov5n", "yolox_nano"} <= set(names)
    for entry in CATALOGUE:
        assert len(entry.classes) == 80
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


def test_a_copyleft_licence_is_told_in_words_before_a_download():
    notice = entry_named("yolov5n").notice
    assert "AGPL-3.0: GNU Affero General Public License" in notice
    assert "4.0 MB from ultralytics/yolov5" in notice


@pytest.mark.parametrize("word", ["YOLOv4-Tiny", "yolov4_tiny", " yolov4-tiny "])
def test_names_are_found_however_they_are_written(word):
    assert entry_named(word).name == "yolov4-tiny"


def test_where_models_live():
    home = Path.home()
    assert models_folder({"TRACK_RANGE_CACHE": "/c"}, platform="linux") == Path("/c/models")
    assert models_folder({"XDG_CACHE_HOME": "/x"}, platform="linux") == Path("/x/track-range/models")
    assert models_folder({"XDG_CACHE_HOME": "x"}, platform="linux") == home / ".cache/track-range/models"
    assert models_folder({}, platform="linux") == home / ".cache/track-range/models"
    assert models_folder({}, platform="darwin") == home / "Library/Caches/track-range/models"
    assert models_folder({"LOCALAPPDATA": "/l"}, platform="win32") == Path("/l/track-range/models")


def test_without_a_home_folder_the_cache_must_be_named(monkeypatch):
    def nowhere():
        raise RuntimeError("no home")

    monkeypatch.setattr(Path, "home", nowhere)
    with pytest.raises(ModelError, match="set TRACK_RANGE_CACHE"):
        models_folder({}, platform="linux")


@pytest.fixture
def places(tmp_path):
    """A packaged and a cache folder, as `find_model` takes them."""
    folders = {"packaged": tmp_path / "packaged", "cache": tmp_path / "cache"}
    for folder in folders.values():
        folder.mkdir()
    return folders


def test_a_word_is_a_file_then_packaged_then_cached_then_of_the_catalogue(places, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find_model("yolov5n", **places).origin == "catalogue"
    assert find_model("yolov5n", **places).path == places["cache"] / "yolov5n.onnx"
    for folder, origin in ((places["cache"], "cached"), (places["packaged"], "packaged"), (tmp_path, "file")):
        (folder / "yolov5n.onnx").touch()
        word = "yolov5n.onnx" if origin == "file" else "YOLOv5n"
        found = find_model(word, **places)
        assert (found.origin, found.path.resolve()) == (origin, folder / "yolov5n.onnx")
    (places["cache"] / "mine.onnx").touch()
    assert find_model("mine", **places).origin == "cached"


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("none/yolov5n", "none/yolov5n: no such model file"),
        ("none.onnx", r"none\.onnx: no such model file"),
        ("yolov5m", "no model of that name: did you mean yolov5n"),
        ("resnet", "known are .*yolov4-tiny"),
    ],
)
def test_words_that_mean_nothing(places, word, message):
    with pytest.raises(ModelError, match=message):
        find_model(word, **places)


def test_the_list_names_what_is_here_and_what_could_be(places):
    (places["packaged"] / "road.onnx").touch()
    for name in ("yolov5n", "mine"):
        (places["cache"] / f"{name}.onnx").touch()
    rows = {row.name: row for row in model_rows(**places)}
    assert rows["road"].state == "packaged"
    assert (rows["yolov5n"].state, rows["yolov4-tiny"].state) == ("here", "to be fetched")
    assert rows["mine"].state == "in the cache folder"
    assert rows["yolov5n"].licence == "AGPL-3.0"
    assert rows["yolov4-tiny"].size == "24.3 MB"
