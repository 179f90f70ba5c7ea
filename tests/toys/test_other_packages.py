"""Objects of other packages, each of one file and an entry point, appear in every output; those of
readers are the examples of docs/project/extending.md."""

import csv
import json
import re
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from tests.support.images.films import write_film
from track_range.detection.formats.detection_files import read_detections
from track_range.detection.formats.label_formats import LABEL_FORMATS
from track_range.detection.yolo.layouts import DETECTOR_LAYOUTS
from track_range.ranging.registry import METHODS
from track_range.recording.telemetry.sidecars.reading import SIDECARS, read_sidecar, sidecar_names
from track_range.recording.telemetry.sidecars.sidecar import Sidecar
from track_range.recording.telemetry.tracks.track import TelemetryError
from track_range.results.writers import WRITERS
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.lenses.registry import LENSES
from track_range.stereo.rig_formats.reading import RIG_FORMATS, load_calibration, load_camera
from track_range.stereo.rig_formats.rig_yaml import save_camera, save_rig
from track_range.tracking.registry import TRACKERS

PAGE = Path(__file__).resolve().parents[2] / "docs/project/extending.md"
EXAMPLES = dict(
    re.findall(
        r"^## (.+)\n(?:(?!^## )[\s\S])*?```python\n([\s\S]*?)```", PAGE.read_text(), re.MULTILINE
    )
)
READERS = {  # group and name of the entry point, and attribute of the module, by section
    "A layout of network outputs": ("detector_layouts", "blocks", "BLOCKS"),
    "A lens": ("lenses", "eucm", "EUCM"),
    "A rig format": ("rig_formats", "flat", "FLAT"),
    "A label format": ("label_formats", "jsonl", "JSONL"),
    "Telemetry beside a video": ("sidecars", "speeds", "SPEEDS"),
}
CHOSEN = {  # of the other kinds
    "ranging_methods": ("toy", "tests.toys.toy_method:TOY"),
    "trackers": ("greedy", "tests.toys.toy_tracker:GreedyIouTracker"),
    "result_writers": ("lines", "tests.toys.toy_writer:JsonLinesWriter"),
}
EUCM = (0.6, 1.1)
CAMERA = PinholeCamera(30.0, 30.0, 31.5, 23.5, 64, 48, EUCM, "eucm")


@pytest.fixture(autouse=True)
def packages(install, tmp_path, monkeypatch):
    """Installs a package for each kind, before the commands that show them are imported."""
    commands = "track_range.cli.commands"
    for module in [name for name in sys.modules if name.startswith(commands)]:
        monkeypatch.delitem(sys.modules, module)
    for section, (group, name, attribute) in READERS.items():
        module = f"package_of_{name}"
        (tmp_path / "site-packages" / f"{module}.py").write_text(EXAMPLES[section])
        install(f"track_range.{group}", **{name: f"{module}:{attribute}"})
    for group, (name, target) in CHOSEN.items():
        install(f"track_range.{group}", **{name: target})
    yield
    for name in [name for name in sys.modules if name.startswith((commands, "package_of_"))]:
        del sys.modules[name]


@pytest.fixture
def succeed(cli, tmp_path):
    """Runs a command that must succeed without a word about packages; its output."""

    def run(*arguments):
        status, printed, complaint = cli(*arguments, folder=tmp_path)
        assert (status, complaint) == (0, ""), complaint
        return printed

    return run


def test_every_kind_has_an_entry_point_and_an_example():
    registries = (METHODS, TRACKERS, WRITERS, DETECTOR_LAYOUTS, LENSES, RIG_FORMATS, LABEL_FORMATS)
    groups = {registry.group for registry in (*registries, SIDECARS)}
    assert groups == {
        f"track_range.{group}" for group in (*CHOSEN, *(group for group, *_ in READERS.values()))
    }
    page = PAGE.read_text()
    assert {"A ranging method", "A note or a figure of a run"} < set(EXAMPLES)
    assert all(f"`{group}`" in page for group in groups)


def test_a_lens_in_files_and_commands(succeed, tmp_path):
    (tmp_path / "camchain.yaml").write_text(
        f"cam0: {{camera_model: eucm, distortion_model: none, resolution: [64, 48], "
        f"intrinsics: {[*EUCM, 30.0, 30.0, 31.5, 23.5]}, distortion_coeffs: []}}\n"
    )
    succeed("rig", "convert", "camchain.yaml", "rig.yaml")
    assert load_camera(tmp_path / "rig.yaml", size_px=None) == (CAMERA, ())
    assert "eucm" in succeed("rig", "show", "rig.yaml")
    (tmp_path / "other.yaml").write_text(
        (tmp_path / "rig.yaml").read_text().replace("eucm", "fish")
    )
    with pytest.raises(RigError, match="'omni' or 'eucm', found 'fish'"):
        load_camera(tmp_path / "other.yaml", size_px=None)
    pixels = np.array([[0.0, 0.0], [31.5, 23.5], [60.0, 40.0]])
    assert np.allclose(CAMERA.recorded_px(CAMERA.recorded_rays(pixels)), pixels)


def test_a_rig_format_in_commands(succeed, tmp_path):
    camera = PinholeCamera(700.0, 700.0, 320.0, 180.0, 640, 360)
    save_rig(StereoRig.rectified(camera, 0.5), tmp_path / "rig.yaml")
    assert "ours|opencv|flat" in succeed("rig", "convert", "--help")
    succeed("rig", "convert", "rig.yaml", "rig.flat", "--to", "flat")
    assert (tmp_path / "rig.flat").read_text() == "flat 700.0 320.0 180.0 640 360 0.5\n"
    assert load_calibration(tmp_path / "rig.flat")[0].baseline_m == 0.5
    assert "0.5" in succeed("rig", "show", "rig.flat")


def test_a_label_format_in_commands(succeed, tmp_path):
    boxes = tmp_path / "boxes.jsonl"
    boxes.write_text(
        "".join(
            f'{{"frame": {i}, "id": 4, "class": "car", "box": [10, 4, 40, 44], "score": 0.9}}\n'
            for i in range(8)
        )
    )
    formats = " ".join(succeed("export", "--help").split()).partition("Format of the output:")[2]
    assert "jsonl" in formats.partition("(required)")[0].replace(",", "").split()
    size = write_film(tmp_path / "film.mp4", [0.1 * i for i in range(8)])
    succeed("export", "boxes.jsonl", "--to", "coco", "--out", "boxes.json", "--video", size)
    succeed("export", "boxes.json", "--to", "jsonl", "--out", "again.jsonl")
    rows = [json.loads(line) for line in (tmp_path / "again.jsonl").read_text().splitlines()]
    assert [(row["frame"], row["id"], row["box"]) for row in rows] == [
        (i, 4, [10, 4, 40, 44]) for i in range(8)
    ]
    assert "100" in succeed(
        "evaluate", "tracks", "--truth", "boxes.jsonl", "--results", "boxes.json"
    )


def test_a_detector_layout_in_commands(succeed, cli, tmp_path):
    block = np.zeros((1, 1, 3, 5), np.float32)
    block[0, 0, 0] = (10, 10, 40, 30, 0.9)
    image = helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 3, 64, 64))
    output = helper.make_tensor_value_info("block", TensorProto.FLOAT, block.shape)
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=1),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
        helper.make_node("Add", ["nothing", "boxes"], ["block"]),
    ]
    weights = [
        numpy_helper.from_array(block, "boxes"),
        numpy_helper.from_array(np.float32([0]), "zero"),
    ]
    graph = helper.make_graph(nodes, "block", [image], [output], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    helper.set_model_props(model, {"names": "{0: 'car'}"})
    onnx.save(model, tmp_path / "net.onnx")
    assert "blocks: one block [1, 1, 3, 5]" in succeed("models", "info", "net.onnx")
    succeed("models", "info", "net.onnx", "--layout", "blocks")
    status, _, complaint = cli("models", "info", tmp_path / "net.onnx", "--layout", "block")
    assert status == 1
    assert complaint.rstrip(".\n").endswith(", blocks")


def test_all_kinds_in_a_run(succeed, tmp_path):
    write_film(tmp_path / "film.mp4", [0.1 * i for i in range(8)])
    save_camera(CAMERA, tmp_path / "rig.yaml")
    (tmp_path / "film.speeds").write_text("".join(f"{0.1 * i} 5.0\n" for i in range(12)))
    (tmp_path / "boxes.jsonl").write_text(
        "".join(
            f'{{"frame": {i}, "id": 4, "class": "car", "box": [20, 14, 44, 34], "score": 0.9}}\n'
            for i in range(8)
        )
    )
    out = tmp_path / "out"
    printed = succeed(
        *("--mono", "film.mp4", "--rig", "rig.yaml", "--detections", "boxes.jsonl"),
        *("--tracker", "greedy", "--write", "csv,lines", "--lanes", "off", "--verbose"),
        *("--out", out),
    )
    table = list(csv.DictReader((out / "tracks.csv").read_text().splitlines()))
    assert {row["track_id"] for row in table} == {"101"}
    assert all(float(row["toy_m"]) > 0 for row in table)
    frames = (out / "frames.jsonl").read_text().splitlines()
    assert json.loads(frames[0])["ids"] == [101]
    summary = json.loads((out / "summary.json").read_text())
    assert summary["methods"]["toy"]["coverage"] == 1.0
    assert "film.speeds" in json.dumps(summary)
    assert "toy" in printed
    settings = (out / "settings.yaml").read_text()
    assert "tests.toys.toy_method:TOY" in settings
    assert "film.speeds" in sidecar_names("film.mp4")


def test_unknown_names_are_answered_with_those_of_packages(cli, tmp_path):
    film = write_film(tmp_path / "film.mp4", [0.0, 0.1])
    for option, known in (("--tracker", "greedy"), ("--write", "lines")):
        status, _, complaint = cli("--mono", film, "--focal-px", 100, option, "none")
        assert status != 0
        assert known in complaint


@pytest.mark.parametrize("group", ["lenses", "rig_formats"])
def test_a_package_that_cannot_be_imported_loses_nothing(group, install, cli, tmp_path):
    install(f"track_range.{group}", broken="no_such_module:THING", odd="os:sep")
    save_camera(CAMERA, path := tmp_path / "rig.yaml")
    status, printed, complaint = cli("rig", "show", path)
    assert status == 0
    assert "eucm" in printed
    lines = complaint.splitlines()
    assert [("broken" in line, "odd" in line) for line in lines] == [(True, False), (False, True)]
    assert all("(package8 1.0)" in line for line in lines)


def test_a_failing_reader_loses_only_its_own_files(install, cli, tmp_path):
    install("track_range.label_formats", failing="package_of_failures:LABELS")
    install("track_range.rig_formats", failing="package_of_failures:RIG")
    (tmp_path / "site-packages/package_of_failures.py").write_text(FAILURES)
    (tmp_path / "k.txt").write_text("0 1 Car 0 0 0 10 10 50 50 -1 -1 -1 -1 -1 -1 -1\n")
    status, printed, complaint = cli(
        *("evaluate", "tracks", "--truth", "k.txt", "--results", "k.txt"), folder=tmp_path
    )
    assert (status, "100" in printed) == (0, True), complaint
    assert "failing = package_of_failures:LABELS (package8 1.0): KeyError" in complaint
    (tmp_path / "odd.yaml").write_text("odd\n")
    status, _, complaint = cli("rig", "show", "odd.yaml", folder=tmp_path)
    assert status == 1
    assert "odd.yaml: entry point failing = package_of_failures:RIG" in complaint
    install("track_range.sidecars", failing="package_of_failures:SIDECAR")
    with pytest.raises(TelemetryError, match=r"film\.odd: entry point failing = .*KeyError"):
        read_sidecar(tmp_path / "film.odd", "film.mp4", 1.0)


FAILURES = """
from track_range.detection.formats.tables.label_format import LabelFormat
from track_range.recording.telemetry.sidecars.sidecar import Sidecar
from track_range.stereo.rig_formats.rig_format import RigFormat

def fail(*arguments):
    return {}["brightness"]

LABELS = LabelFormat(name="failing", title="", recognises=fail, read=fail)
RIG = RigFormat(
    name="failing", title="", recognises=lambda text: text == "odd\\n", read=fail, missing=fail
)
SIDECAR = Sidecar(suffixes=(".odd",), read=fail)
"""


def test_labels_of_a_package_are_detections_by_default(tmp_path):
    path = tmp_path / "boxes.jsonl"
    path.write_text('{"frame": 0, "id": 4, "class": "car", "box": [1, 4, 40, 44], "score": 0.9}\n')
    found = read_detections(path)
    assert (found.form, found.detections.xyxy_px.tolist()) == ("labels", [[1, 4, 40, 44]])


@pytest.mark.parametrize("suffixes", [(".GPX2",), ".gpx", ("gpx",)])
def test_suffixes_that_are_never_found(suffixes):
    with pytest.raises(ValueError, match="in lower case and with a dot"):
        Sidecar(suffixes=suffixes, read=lambda *_: None)


def test_a_note_of_a_run(tmp_path):
    module = tmp_path / "site-packages/package_of_a_note.py"
    module.write_text(EXAMPLES["A note or a figure of a run"])
    part = import_module("package_of_a_note").ManyPredicted
    assert part({"observed": np.array([1, 0, 0])}).notes()
    assert not part({"observed": np.array([1, 1, 0])}).notes()


def test_an_unusable_package_is_a_note_of_a_run(install, cli, tmp_path):
    install("track_range.sidecars", broken="no_such_module:THING")
    film = write_film(tmp_path / "film.mp4", [0.0, 0.1, 0.2])
    status, printed, complaint = cli(
        *("--mono", film, "--focal-px", 100, "--out", tmp_path / "out", "--no-overlay")
    )
    assert (status, complaint) == (0, "")
    notes = json.loads((tmp_path / "out" / "summary.json").read_text())["notes"]
    assert [note for note in notes if "broken = no_such_module:THING (package8 1.0)" in note]
    assert "no_such_module" in printed
