"""`--methods`, `--show-only`, `--depth-model` and `--stereo-model` of a run."""

import csv
import json
import pickle
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

import track_range as tr
from tests.support.networks.depth_networks import write_depth, write_stereo
from tests.toys.toy_method import TOY
from track_range.foundation.errors import UsageError, UserError
from track_range.ranging import registry
from track_range.results.folder import read_run_folder

TOY_OBJECT = "tests.toys.toy_method:TOY"
DEPTH_M = 5.0  # near what the sizes say: distances that are several times as large are left out


@pytest.fixture(autouse=True)
def registered():
    with registry.METHODS.restored():
        yield


@pytest.fixture
def mono_run(tmp_path, film, cli):
    """Runs on a video of eight frames with a box each; returns the folder, or the error."""
    video = film(tmp_path / "film.mp4", [0.1 * i for i in range(8)])
    boxes = tmp_path / "boxes.txt"
    boxes.write_text("".join(f"{i},10,4,40,40,0.9\n" for i in range(8)))

    def run(*options, status=0, name="out"):
        out = tmp_path / name
        given = ("--mono", video, "--focal-px", 100, "--detections", boxes, "--lanes", "off")
        found, _, complaint = cli(*given, "--no-overlay", "--out", out, *options)
        assert found == status, complaint
        return complaint if status else out

    return run


@pytest.fixture
def network(tmp_path):
    """Networks that give one depth for all pixels."""

    def write(name="net.onnx", depth_m=DEPTH_M):
        return write_depth(tmp_path / name, constant=depth_m)

    return write


def rows_of(out):
    return list(csv.DictReader((out / "tracks.csv").read_text().splitlines()))


def summary_of(out):
    return json.loads((out / "summary.json").read_text())


def distances_of(rows):
    return {name.removesuffix("_m") for name in rows[0] if rows[-1][name] and name.endswith("_m")}


def test_chosen_methods_measure_alone(mono_run):
    everything = rows_of(mono_run())
    chosen = rows_of(mono_run("--methods", "mono", name="mono"))
    assert {"mono", "ground", "fused"} <= distances_of(everything)
    assert {"mono", "fused"} <= distances_of(chosen)
    assert "ground" not in distances_of(chosen)
    assert chosen[0].keys() == everything[0].keys()  # readers by position keep their columns


def test_method_of_a_module_is_in_this_run_only(mono_run):
    out = mono_run("--methods", f"mono,{TOY_OBJECT}")
    rows = rows_of(out)
    assert list(rows[0])[-4:] == ["toy_m", "toy_sigma_m", "toy_kf_m", "toy_kf_sigma_m"]
    assert float(rows[-1]["toy_m"]) == pytest.approx(100 * 1.8 / 30, abs=0.01)
    assert summary_of(out)["stages_ms"]["toy"] > 0
    later = mono_run(name="later")  # in the same process
    assert "toy_m" not in rows_of(later)[0]
    assert "toy" not in summary_of(later)["stages_ms"]
    assert "\nmethods:" not in (out / "settings.yaml").read_text()  # they follow from the options


def test_script_of_the_current_folder(mono_run, tmp_path, monkeypatch):
    (tmp_path / "local_method.py").write_text("from tests.toys.toy_method import TOY as METHOD\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if folder])
    assert "toy" in distances_of(rows_of(mono_run("--methods", "mono,local_method.py:METHOD")))
    sys.modules.pop("local_method")


def test_settings_repeat_a_run_with_a_method_of_a_module_and_a_network(
    mono_run, network, cli, tmp_path
):
    given = ("--methods", f"mono,{TOY_OBJECT}", "--show-only", "toy")
    out = mono_run(*given, "--depth-model", network())
    registry.METHODS.registered.clear()  # as in a new process
    again = tmp_path / "again"
    status, _, complaint = cli("run", "--settings", out / "settings.yaml", "--out", again)
    assert status == 0, complaint
    assert rows_of(again) == rows_of(out)
    assert {"toy", "depth"} <= distances_of(rows_of(again))


@pytest.mark.parametrize("shown", [TOY_OBJECT, "depth"])
def test_what_is_only_shown_changes_nothing_else(mono_run, network, shown):
    plain = rows_of(mono_run())
    more = ("--depth-model", network()) if shown == "depth" else ()
    out = mono_run(*more, "--show-only", shown, name="shown")
    rows, name = rows_of(out), "toy" if shown == TOY_OBJECT else "depth"
    assert rows[-1][f"{name}_m"]
    assert [{key: row[key] for key in plain[0]} for row in rows] == plain
    assert summary_of(out)["shown_only"] == [name]
    assert summary_of(out)["methods"][name]["coverage"] > 0


def test_a_method_that_does_not_fuse_says_so_itself(mono_run):
    plain = rows_of(mono_run())
    registry.register(replace(TOY, fuses=False))
    rows = rows_of(mono_run(name="registered"))
    assert rows[-1]["toy_m"]
    assert [row["fused_m"] for row in rows] == [row["fused_m"] for row in plain]


def test_depth_network(mono_run, network):
    out = mono_run("--depth-model", network())
    rows, summary = rows_of(out), summary_of(out)
    assert float(rows[-1]["depth_m"]) > 0 < float(rows[-1]["depth_sigma_m"])
    (described,) = summary["networks"]
    assert (described["method"], described["file"]) == ("depth", "net.onnx")
    assert len(described["sha256"]) == 64
    assert described["device"] == "cpu"
    assert summary["stages_ms"]["depth"] == described["ms_per_frame"] > 0
    files = [file for file in summary["provenance"]["files"] if file["role"] == "depth_model"]
    assert [file["name"] for file in files] == ["net.onnx", "net.yaml"]
    assert files[0]["sha256"] == described["sha256"]


def test_several_networks_have_the_names_of_their_files(mono_run, network):
    one, two = network("Big Net.v2.onnx", 10.0), network("far_40.onnx", 40.0)
    out = mono_run("--depth-model", one, "--depth-model", two, "--show-only", "depth-far-40")
    rows = rows_of(out)
    assert {"depth-big-net-v2", "depth-far-40"} <= distances_of(rows)
    assert "depth_m" not in rows[0]
    letters = [method.letter for method in registry.methods()]
    assert len(set(letters)) == len(letters)
    # a later process does not need the files
    before = [(one.name, one.letter, one.colour) for one in registry.methods()]
    registry.METHODS.registered.clear()
    one.unlink()
    run = read_run_folder(out)
    assert {"depth-big-net-v2", "depth-far-40"} <= {*run.rows.methods_measured}
    assert [(one.name, one.letter, one.colour) for one in registry.methods()] == before


@pytest.mark.parametrize(
    ("options", "status", "words"),
    [
        (("--methods", "mnoo"), 2, r"--methods: unknown ranging method 'mnoo': did you mean mono"),
        (("--show-only", "xyz"), 2, r"--show-only: unknown ranging method 'xyz': expected mono"),
        (("--methods", "stereo"), 1, r"stereo: expected two cameras \(--stereo LEFT RIGHT\)"),
        (("--methods", "depth"), 1, r"depth: expected its network \(--depth-model"),
        (("--methods", "lane"), 1, r"lane: expected lane lines"),
        (("--methods", "mono", "--show-only", "mono"), 1, r"--show-only: .*left for the fused"),
        (("--methods", "tests.toys.toy_method:BOX"), 2, r"--methods: .*no attribute 'BOX'"),
        (("--stereo-model", "net.onnx"), 2, r"--stereo-model .*--depth-model"),
        (("--depth-model", "none.onnx"), 1, r"none\.onnx: no such file"),
    ],
)
def test_what_a_run_cannot_have_is_said(mono_run, options, status, words):
    assert re.search(words, mono_run(*options, status=status))


def test_unusable_networks_of_a_pipeline_are_said_before_the_first_frame(network, tmp_path):
    with pytest.raises(UserError, match=r"none\.onnx: no such file"):
        tr.Pipeline.mono(focal_px=200.0, depth_model=tmp_path / "none.onnx")
    with pytest.raises(UserError, match=r"stereo_model= .*depth_model="):
        tr.Pipeline.mono(focal_px=200.0, stereo_model=write_stereo(tmp_path / "stereo.onnx"))
    with pytest.raises(UserError, match="expected a depth network, found a stereo network"):
        tr.Pipeline.mono(focal_px=200.0, depth_model=write_stereo(tmp_path / "stereo.onnx"))


def test_equal_names_of_two_networks(mono_run, network):
    one, two = network("a_b.onnx"), network("a-b.onnx")
    complaint = mono_run("--depth-model", one, "--depth-model", two, status=2)
    assert "depth-a-b" in complaint
    assert "rename" in complaint


def test_keywords_in_python(mono_run, network, tmp_path):
    given = {"focal_px": 100.0, "detections": tmp_path / "boxes.txt", "lanes": "off"}
    run = tr.Run.mono(
        tmp_path / "film.mp4", **given, depth_model=network(), methods=("mono",), show_only="depth"
    )
    results = list(run)
    assert {"mono", "depth", "fused"} <= results[-1].ranges.keys()
    assert "ground" not in results[-1].ranges
    assert results[-1].shown_only == {"depth"}
    with pytest.raises(UsageError, match="methods: unknown ranging method 'mnoo'"):
        tr.Run.mono(tmp_path / "film.mp4", **given, methods="mnoo")


def test_a_restored_pipeline_has_its_networks(network, tmp_path):
    """The network is opened again, from its file; everything else goes on as it was."""
    options = {"sgbm": False, "deterministic": True, "depth_model": network(), "lanes": "off"}
    images = np.random.default_rng(0).integers(0, 256, (6, 240, 320, 3), np.uint8)
    boxes = OneBox()
    with tr.Pipeline.mono(focal_px=200.0, detector=boxes, **options) as whole:
        for k in range(4):
            whole.step(images[k], 0.1 * k)
        state = pickle.loads(pickle.dumps(whole.state()))  # noqa: S301 - our own
        wanted = [whole.step(images[k], 0.1 * k) for k in (4, 5)]
        table = whole.to_arrow()
    assert np.isfinite(wanted[-1].ranges["depth"].distance_m).all()
    with tr.Pipeline.restore(state, detector=boxes) as again:
        for k, expected in zip((4, 5), wanted, strict=True):
            found = again.step(images[k], 0.1 * k).ranges["depth"]
            np.testing.assert_array_equal(found.distance_m, expected.ranges["depth"].distance_m)
            np.testing.assert_array_equal(found.sigma_m, expected.ranges["depth"].sigma_m)
        assert again.to_arrow().equals(table)
        assert "depth_m" in table.column_names
    (tmp_path / "net.onnx").unlink()
    with pytest.raises(UserError, match=r"net\.onnx"):
        tr.Pipeline.restore(state, detector=boxes)


class OneBox:
    """A detector that sees a car at the same place in every image."""

    def detect(self, image):
        return tr.Detections.of([(100.0, 60.0, 200.0, 160.0)], [0.9], [2])
