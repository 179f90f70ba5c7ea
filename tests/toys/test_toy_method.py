"""A registered method of another package appears in every output of a run, with no other file
touched."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from tests.support.images.films import write_film
from tests.support.results.overlay_results import BOX, result
from tests.toys.registrations import registered_method
from tests.toys.toy_method import TOY, BoxWidthRanger
from track_range.foundation.errors import UserError
from track_range.foundation.files.structured_text import read_yaml
from track_range.pipeline.colours import colour_of_each
from track_range.ranging.evaluation.box_methods import method_names
from track_range.views.overlay.labels import corner_lines, label_lines

TOY_M = 100 * 1.8 / 30


@pytest.fixture
def toy():
    with registered_method(TOY):
        yield


@pytest.fixture
def run_folder(tmp_path, cli):
    """Runs on a film of eight frames with a box in each."""
    video, boxes = tmp_path / "film.mp4", tmp_path / "boxes.txt"
    write_film(video, [0.1 * i for i in range(8)])
    boxes.write_text("".join(f"{i},10,4,40,47,0.9\n" for i in range(8)))

    def run(expected=0, name="out", more=()):
        out = tmp_path / name
        arguments = (
            "--mono",
            video,
            "--focal-px",
            100,
            "--detections",
            boxes,
            "--lanes",
            "off",
            "--verbose",
            "--out",
            out,
        )
        status, printed, complaint = cli(*arguments, *more)
        assert status == expected, complaint
        return out, complaint if expected else printed

    return run


def text_of(lines):
    return " ".join(span.text for line in lines for span in line)


def assert_is_everywhere(out, printed):
    table = (out / "tracks.csv").read_text().splitlines()
    assert table[0].endswith(",toy_m,toy_sigma_m,toy_kf_m,toy_kf_sigma_m")
    last = list(csv.DictReader(table))[-1]
    cells = [float(last[name]) for name in ("toy_m", "toy_sigma_m", "toy_kf_m")]
    assert cells == pytest.approx([TOY_M, 0.1 * TOY_M, TOY_M], abs=0.01)
    assert not last["mono_m"]  # the box is cut off at the bottom: toy measures alone
    assert float(last["fused_m"]) == pytest.approx(TOY_M, abs=0.01)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["stages_ms"]["toy"] > 0
    assert summary["methods"]["toy"]["coverage"] == summary["methods"]["toy_kf"]["coverage"] == 1.0
    assert summary["toy_boxes"] == 8
    assert "toy: 8 boxes." in summary["notes"]
    assert re.search(r"^\W*toy\b.*\b100\b", printed, re.MULTILINE)
    page = (out / "report.html").read_text()
    assert TOY.colour in page
    assert re.search(r"<t[hd][^>]*>\s*toy\b", page)


def test_toy_method_in_every_output_of_a_run(toy, run_folder):
    assert_is_everywhere(*run_folder())


def test_toy_method_by_entry_point(run_folder, install):
    install("track_range.ranging_methods", toy="tests.toys.toy_method:TOY")
    assert_is_everywhere(*run_folder())


def test_broken_entry_point_is_a_note(run_folder, install):
    install("track_range.ranging_methods", toy="tests.no_such_method:TOY")
    out, printed = run_folder()
    notes = json.loads((out / "summary.json").read_text())["notes"]
    assert [note for note in notes if "toy = tests.no_such_method:TOY" in note]
    assert "tests.no_such_method" in printed


def test_toy_method_in_the_overlay(toy):
    frame_result = result(
        [BOX], ranges={"toy": (33.3, 1.0), "mono": (30.0, 2.0), "fused": (31.0, 1.0)}
    )
    assert "W 33.3" in text_of(
        label_lines(frame_result, 0, class_names=("a", "b", "c"), sizes_px=(20, 12))
    )
    assert "W box width" in text_of(corner_lines(frame_result, 12)[1])
    assert colour_of_each(["toy_kf"]) == {"toy_kf": TOY.colour}
    shown_only = replace(frame_result, shown_only=frozenset(["toy"]))
    assert "W box width (not fused)" in text_of(corner_lines(shown_only, 12)[1])


def test_toy_method_is_gone_without_its_registration(run_folder):
    out, _ = run_folder()
    assert "toy" not in (out / "tracks.csv").read_text()
    assert "toy" not in json.loads((out / "summary.json").read_text())["methods"]


class Failing(BoxWidthRanger):
    """Its standard deviation is invalid in frames 1 to 3; it fails in frame 5, and at the end."""

    def measure(self, tracks, frame):
        ranges = super().measure(tracks, frame)
        sigma_m = {1: np.nan, 2: 0.0, 3: np.inf}.get(frame.index, 1.0)
        sigma_m /= 5 - frame.index
        return replace(ranges, sigma_m=np.full(len(tracks), sigma_m))

    def summary(self):
        return {"toy": self.missing}

    def notes(self):  # an attribute in `Ranger`
        return ("a note",)


def test_method_that_fails_is_named_and_the_frames_before_it_are_kept(run_folder):
    with registered_method(replace(TOY, create=lambda context: Failing(context.camera))):
        out, complaint = run_folder(1)
    assert re.search(
        r"ranging method 'toy', frame 5: ZeroDivisionError: .*line \d+ of test_toy_method.py",
        complaint,
    )
    assert "Traceback" not in complaint
    rows = list(csv.DictReader((out / "tracks.csv").read_text().splitlines()))
    assert [row["frame"] for row in rows if row["toy_m"]] == ["0", "4"]
    assert rows[-1]["frame"] == "4"
    notes = json.loads((out / "summary.json").read_text())["notes"]
    assert any(
        note.startswith("The run was stopped early, after 5 frames: ranging method 'toy'")
        for note in notes
    )
    assert [
        note
        for note in notes
        if note.startswith("Ranging method 'toy': skipped 3 values,") and "sigma_m in 3)" in note
    ]
    ends = [note for note in notes if note.startswith("ranging method 'toy', end of the run: ")]
    assert sorted(note.split(": ")[1] for note in ends) == ["AttributeError", "TypeError"]


def test_cause_of_a_stop_may_name_folders(run_folder):
    with registered_method(replace(TOY, create=lambda context: Failing(context.camera))):
        out, _ = run_folder(1, more=("--anonymize",))
    assert (
        "The run was stopped early, after 5 frames."
        in json.loads((out / "summary.json").read_text())["notes"]
    )


def test_settings_name_the_methods_of_others(run_folder, cli):
    plain, _ = run_folder()
    with registered_method(TOY):
        out, _ = run_folder(name="with")
        assert cli("--settings", out / "settings.yaml", "--out", out.parent / "again")[0] == 0
    documents = [
        read_yaml(folder / "settings.yaml", UserError, "settings") for folder in (plain, out)
    ]
    assert "methods" not in documents[0]
    assert documents[1]["methods"] == {"toy": "tests.toys.toy_method:<lambda>"}
    assert documents[0]["settings_hash"] != documents[1]["settings_hash"]
    hashes = [
        json.loads((folder / "summary.json").read_text())["settings_hash"]
        for folder in (plain, out)
    ]
    assert hashes == [document["settings_hash"] for document in documents]
    status, _, complaint = cli("--settings", out / "settings.yaml")
    assert status == 1
    assert "'toy'" in complaint
    assert "'methods'" in complaint


def test_toy_method_on_labelled_boxes(toy):
    assert method_names()[-4:] == ("mono", "ground", "toy", "mono+ground+toy")
