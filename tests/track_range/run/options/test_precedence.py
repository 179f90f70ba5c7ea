from pathlib import Path

import pytest
import yaml

from track_range.foundation.errors import ConfigError, UsageError
from track_range.run.options.precedence import settings_from
from track_range.run.options.settings_file import save_settings

PAIR = {"stereo": (Path("left.mp4"), Path("right.mp4")), "detector": "m.onnx"}


def test_output_folder_is_named_after_the_left_video():
    assert settings_from(PAIR).out_dir == Path("left-track-range")
    assert settings_from({**PAIR, "out": Path("x")}).out_dir == Path("x")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "--mono"),
        ({**PAIR, "mono": Path("m.mp4")}, "--mono"),
        ({**PAIR, "detections": Path("d.txt")}, "--detections"),
        ({**PAIR, "disparity": True, "sgbm": False}, "--disparity"),
        ({"mono": Path("m.mp4"), "detector": "m", "disparity": True}, "--disparity"),
        ({**PAIR, "threads": -1}, "--threads: "),
        ({**PAIR, "start_s": float("nan")}, "--start: "),
        ({**PAIR, "device": "abacus"}, "--device: "),
        ({"mono": Path("m.mp4"), "detector": "m", "rig": Path("r"), "focal_px": 7.0}, "--focal-px"),
        ({"mono": Path("m.mp4"), "detector": "m", "focal_px": -7.0}, "--focal-px: "),
        ({"mono": Path("m.mp4"), "detector": "m", "focal_px": float("inf")}, "--focal-px: "),
        ({**PAIR, "folder_fps": float("inf")}, "--fps: "),
    ],
)
def test_invalid_options(given, message):
    with pytest.raises(UsageError) as raised:
        settings_from(given)
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_earlier_name_of_the_frame_rate(tmp_path):
    assert settings_from({**PAIR, "folder_fps": 20}).fps == 20.0
    text = (
        "track_range_settings: 1\nrun: {{stereo: [l.mp4, r.mp4], detections: d, folder_fps: {}}}\n"
    )
    file = tmp_path / "settings.yaml"
    for rate, kept in ((12.0, 12.0), (10.0, None)):  # 10 was the default, also of other videos
        file.write_text(text.format(rate))
        assert settings_from({}, file).fps == kept
    assert settings_from({"folder_fps": 20}, file).fps == 20.0


def test_settings_file_and_overriding_options(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    settings = settings_from({**PAIR, "classes": ("car", "bus"), "duration_s": 2.0, "sgbm": False})
    save_settings(settings, tmp_path / "settings.yaml", detected={"fps": 10.0})
    again = settings_from({"duration_s": 3.0}, tmp_path / "settings.yaml")
    assert again.stereo == (tmp_path / "left.mp4", tmp_path / "right.mp4")
    assert (again.classes, again.sgbm, again.duration_s) == (("car", "bus"), False, 3.0)
    (tmp_path / "classes.txt").write_text("person\ncar\n")
    save_settings(
        settings_from({**PAIR, "names": "classes.txt"}), tmp_path / "named.yaml", detected={}
    )
    assert settings_from({}, tmp_path / "named.yaml").names == str(tmp_path / "classes.txt")
    (tmp_path / "net.onnx").touch()
    # a name stays a name
    for word, kept in (("yolov5n", "yolov5n"), ("net.onnx", str(tmp_path / "net.onnx"))):
        save_settings(
            settings_from({**PAIR, "detector": word}), tmp_path / "word.yaml", detected={}
        )
        assert settings_from({}, tmp_path / "word.yaml").detector == kept
    single = {"mono": Path("m.mp4"), "detector": "m.onnx", "rig": Path("rig.yaml")}
    save_settings(settings_from(single), tmp_path / "single.yaml", detected={})
    assert settings_from({"focal_px": 700.0}, tmp_path / "single.yaml").rig is None
    mono = settings_from(
        {"mono": Path("m.mp4"), "detections": Path("d.txt")}, tmp_path / "settings.yaml"
    )
    assert (mono.stereo, mono.detector, mono.mono) == (None, None, Path("m.mp4"))


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("a: [", "YAML"),
        ("just text", "track_range_settings"),
        ("track_range_settings: 1", "run:"),
        ("track_range_settings: 1\nrun: {1: 2}", "run:"),
        (
            yaml.safe_dump({"track_range_settings": 1, "run": {"colour": "red", "detector": "m"}}),
            "colour",
        ),
        (
            yaml.safe_dump({"track_range_settings": 1, "run": {"sgbm_options": {"block_size": 4}}}),
            "sgbm_options.*block_size",
        ),
        (
            yaml.safe_dump({"track_range_settings": 1, "run": {"sgbm_options": {"blocks": 5}}}),
            "sgbm_options.*blocks",
        ),
    ],
)
def test_unusable_settings_files(tmp_path, content, word):
    file = tmp_path / "settings.yaml"
    file.write_text(content)
    with pytest.raises(ConfigError, match=rf"settings\.yaml.*: .*{word}") as raised:
        settings_from({}, file)
    assert not isinstance(raised.value, UsageError)


CONTRADICTION = "run: {mono: a.mp4, detector: m, clips: true, overlay: false}"


@pytest.mark.parametrize(
    ("run", "given", "kind", "pattern"),
    [
        (CONTRADICTION, {}, ConfigError, r"s\.yaml: --clips"),
        (CONTRADICTION, {"threads": 2}, ConfigError, r"s\.yaml: --clips"),
        (
            "run: {mono: a.mp4, clips: true}",
            {"overlay": False},
            UsageError,
            r"--clips.*\(with .*s\.",
        ),
        ("run: {}", {}, ConfigError, r"s\.yaml: .*--mono"),
        ("run: {threads: -1}", {"mono": "a.mp4"}, ConfigError, r"s\.yaml: 'run\.threads'"),
        ("run: {threads: 1}", {"mono": "a.mp4", "threads": -1}, UsageError, "^--threads"),
        ("run: {reid: r.onnx}", {"mono": "a.mp4", "tracker": "sort"}, UsageError, r"--reid.*s\."),
        ("run: {reid: r.onnx, tracker: sort}", {"mono": "a.mp4"}, ConfigError, r"s\.yaml: --reid"),
    ],
)
def test_error_names_the_source_of_its_causes(tmp_path, run, given, kind, pattern):
    file = tmp_path / "s.yaml"
    file.write_text(f"track_range_settings: 1\n{run}\n")
    with pytest.raises(kind, match=pattern) as raised:
        settings_from(given, file)
    assert type(raised.value) is kind


def test_missing_settings_file(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.yaml"):
        settings_from({}, tmp_path / "none.yaml")


def test_settings_are_frozen():
    with pytest.raises(ValueError, match="frozen"):
        settings_from(PAIR).threads = 3


def test_packaged_detector_is_the_default(tmp_path):
    assert settings_from({"mono": Path("m.mp4")}).detector == "road"
    boxes = settings_from({"mono": Path("m.mp4"), "detections": Path("d.txt")})
    assert boxes.detector is None
    save_settings(settings_from({"mono": Path("m.mp4")}), tmp_path / "s.yaml", detected={})
    assert settings_from({}, tmp_path / "s.yaml").detector == "road"
    again = settings_from({"detections": Path("d.txt")}, tmp_path / "s.yaml")
    assert (again.detector, again.detections) == (None, Path("d.txt"))


def test_reid_needs_a_tracker_that_compares_appearance() -> None:
    with pytest.raises(UsageError, match=r"--reid.*sort"):
        settings_from({"mono": Path("a.mp4"), "reid": Path("r.onnx"), "tracker": "sort"})
    with pytest.raises(UsageError, match=r"--tracker: .*kalman"):
        settings_from({"mono": Path("a.mp4"), "tracker": "kalman"})
    assert settings_from({"mono": Path("a.mp4"), "reid": Path("r.onnx")}).tracker == "road"


def test_sgbm_options_and_alignment_in_the_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    chosen = {"mode": "hh", "block_size": 7}
    save_settings(
        settings_from({**PAIR, "sgbm_options": chosen, "align": "off"}),
        tmp_path / "s.yaml",
        detected={},
    )
    again = settings_from({}, tmp_path / "s.yaml")
    assert (again.sgbm_options, again.align) == (chosen, "off")
    (tmp_path / "hand.yaml").write_text("track_range_settings: 1\nrun: {align: off}\n")
    assert settings_from(PAIR, tmp_path / "hand.yaml").align == "off"
    (tmp_path / "align.yaml").touch()
    save_settings(settings_from({**PAIR, "align": "align.yaml"}), tmp_path / "s.yaml", detected={})
    assert settings_from({}, tmp_path / "s.yaml").align == str(tmp_path / "align.yaml")
    assert settings_from(PAIR).align == "auto"
