"""Files for the results of `track-range evaluate`."""

from __future__ import annotations

import pytest

from tests.support.command_line import run_command


@pytest.mark.parametrize(
    "inputs",
    [
        ("tracks", "--results", "--truth"),
        ("events", "--events", "--truth"),
    ],
)
def test_inputs_are_not_replaced(inputs, tmp_path):
    command, *flags = inputs
    path = tmp_path / "input.txt"
    path.write_text("0 0 Car 0 0 0 10 10 60 60 1.5 1.6 4 0 1.6 20 0\n")
    arguments = [argument for flag in flags for argument in (flag, path)]
    done = run_command("evaluate", command, *arguments, "--json", path)
    assert done.status == 1
    assert "the file of --" in done.stderr
    assert path.read_text().startswith("0 0 Car")


def contacts_command(tmp_path, *outputs):
    path = tmp_path / "missing.csv"
    return run_command("evaluate", "events", "--events", path, "--truth", path, *outputs)


def test_files_are_checked_before_the_evaluation(tmp_path):
    (tmp_path / "folder.json").mkdir()
    for name in ("no/such/folder/f.json", "folder.json"):
        done = contacts_command(tmp_path, "--json", tmp_path / name)
        assert (done.status, "cannot be written" in done.stderr, "missing.csv" in done.stderr) == (
            1,
            True,
            False,
        )
    assert not (tmp_path / "no").exists()
    assert "missing.csv" in contacts_command(tmp_path, "--json", tmp_path / "f.json").stderr


def test_two_outputs_in_one_file(tmp_path):
    folders = ("--labels", tmp_path / "labels", "--calib", tmp_path / "calib")
    done = run_command(
        "evaluate", "ranges", *folders, "--json", tmp_path / "f", "--table", tmp_path / "f"
    )
    assert (done.status, "different files" in done.stderr) == (1, True)
    done = run_command(
        "evaluate", "ranges", *folders, "--json", "/dev/null", "--table", "/dev/null"
    )
    assert "different files" not in done.stderr  # written in place


def test_images_are_not_replaced_by_a_chart(tmp_path):
    (tmp_path / "0.png").write_bytes(b"image")
    inputs = ("--model", "missing.onnx", "--images", tmp_path, "--labels", tmp_path)
    done = run_command("evaluate", "detections", *inputs, "--figure", tmp_path / "0.png")
    assert (done.status, "the file of --images" in done.stderr) == (1, True)


def test_models_are_not_replaced(tmp_path):
    model = tmp_path / "my.onnx"
    model.write_bytes(b"model")
    inputs = ("--model", "yolov5n", "--model", model, "--images", tmp_path, "--labels", tmp_path)
    done = run_command("evaluate", "detections", *inputs, "--json", model)
    assert (done.status, "the file of --model;" in done.stderr) == (1, True)
    assert model.read_bytes() == b"model"


def test_attributes_of_models_are_not_replaced(tmp_path):
    (tmp_path / "my.onnx").write_bytes(b"model")
    sidecar = tmp_path / "my.yaml"
    sidecar.write_text("size: 640")
    inputs = (
        "--model",
        tmp_path / "my.onnx",
        "--images",
        tmp_path / "images",
        "--labels",
        tmp_path / "labels",
    )
    done = run_command("evaluate", "detections", *inputs, "--json", sidecar)
    assert (done.status, "the file of --model;" in done.stderr) == (1, True)
    assert sidecar.read_text() == "size: 640"


def test_earlier_results_beside_the_inputs_are_replaced(tmp_path):
    for name in ("risk.png", "table.md", "f.json"):
        (tmp_path / name).write_text("")
    outputs = (
        "--figure",
        tmp_path / "risk.png",
        "--table",
        tmp_path / "table.md",
        "--json",
        tmp_path / "f.json",
    )
    done = run_command("evaluate", "ranges", "--labels", tmp_path, "--calib", tmp_path, *outputs)
    assert "expected a new file" not in done.stderr
