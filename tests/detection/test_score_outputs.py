"""Calibrated copies of networks, and the command that writes them."""

import json

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from scipy.special import expit, logit

from tests.support.networks.onnx_models import write_model
from track_range.detection.evaluation.calibrated_copy import write_calibrated, write_calibrated_copy
from track_range.detection.evaluation.score_fit import ScoreSamples, fit_scores
from track_range.detection.models.onnx_session import ModelError, OnnxSession
from track_range.detection.yolo.detector import YoloDetector

SLOPE, OFFSET = np.array([1.5, 0.5, 1.0]), np.array([-0.3, 0.7, 0.0])


def network(path, *, has_sigmoid_last):
    """A network with scores (1, 64, 3) that are sigmoids of multiples of the pixels, and an output
    of other values."""
    info = helper.make_tensor_value_info
    nodes = [
        helper.make_node("Slice", ["images", "zero", "eight", "axis"], ["corner"]),
        helper.make_node("Reshape", ["corner", "cells"], ["rows"]),
        helper.make_node("Mul", ["rows", "weights"], ["logits"]),
        helper.make_node("Identity", ["logits"], ["others"]),
    ]
    if has_sigmoid_last:
        nodes[-1] = helper.make_node("Sigmoid", ["logits"], ["scores"])
        # another use of the scores
        nodes.append(helper.make_node("Identity", ["scores"], ["others"]))
    else:
        nodes += [
            helper.make_node("Sigmoid", ["logits"], ["inner"]),
            helper.make_node("Identity", ["inner"], ["scores"]),
        ]
    constants = {
        "zero": np.array([0]),
        "eight": np.array([1]),
        "axis": np.array([1]),
        "cells": np.array([1, 64, 1]),
        "weights": np.array([1.0, -2.0, 4.0], np.float32),
    }
    outputs = [info(name, TensorProto.FLOAT, (1, 64, 3)) for name in ("others", "scores")]
    graph = helper.make_graph(
        nodes,
        "scores",
        [info("images", TensorProto.FLOAT, (1, 3, 8, 8))],
        outputs,
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)])
    model.ir_version = 9
    helper.set_model_props(model, {"names": "['car']"})
    onnx.save(model, path)
    return path


@pytest.mark.parametrize("has_sigmoid_last", [True, False])
def test_scores_are_calibrated_and_other_outputs_unchanged(tmp_path, has_sigmoid_last):
    path = network(tmp_path / "a.onnx", has_sigmoid_last=has_sigmoid_last)
    write_calibrated(path, tmp_path / "b.onnx", score_outputs=[1], slope=SLOPE, offset=OFFSET)
    write_calibrated(
        tmp_path / "b.onnx", tmp_path / "b.onnx", score_outputs=[1], slope=SLOPE, offset=OFFSET
    )
    image = np.random.default_rng(0).uniform(-1, 1, (1, 3, 8, 8)).astype(np.float32)
    (others, scores), (same, twice) = (
        OnnxSession(tmp_path / name).run(image) for name in ("a.onnx", "b.onnx")
    )
    assert np.array_equal(others, same)
    onnx.checker.check_model(onnx.load(tmp_path / "b.onnx"))
    once = expit(SLOPE * logit(scores.astype(np.float64)) + OFFSET)
    assert twice == pytest.approx(expit(SLOPE * logit(once) + OFFSET), abs=1e-5)
    assert OnnxSession(tmp_path / "b.onnx").metadata == {"names": "['car']"}


def test_scores_of_exactly_0_and_1(tmp_path):
    path = network(tmp_path / "a.onnx", has_sigmoid_last=False)
    write_calibrated(path, tmp_path / "b.onnx", score_outputs=[1], slope=SLOPE, offset=OFFSET)
    _, scores = OnnxSession(tmp_path / "b.onnx").run(np.full((1, 3, 8, 8), 1e4, np.float32))
    assert np.isfinite(scores).all()
    assert scores[0, 0] == pytest.approx([1, 0, 1], abs=1e-2)


def test_half_precision(tmp_path):
    scores = np.linspace(0, 1, 12).reshape(1, 4, 3)
    write_model(tmp_path / "a.onnx", scores, is_half=True)
    write_calibrated(
        tmp_path / "a.onnx", tmp_path / "b.onnx", score_outputs=[0], slope=SLOPE, offset=OFFSET
    )
    (calibrated,) = OnnxSession(tmp_path / "b.onnx").run(np.zeros((1, 3, 64, 64), np.float32))
    inside = np.clip(scores, 1e-3, 1 - 1e-3)
    assert calibrated == pytest.approx(expit(SLOPE * logit(inside) + OFFSET), abs=2e-3)


def test_unreadable_file(tmp_path):
    (tmp_path / "a.onnx").write_bytes(b"no network")
    with pytest.raises(ModelError, match="not a readable ONNX model"):
        write_calibrated(
            tmp_path / "a.onnx", tmp_path / "b.onnx", score_outputs=[0], slope=SLOPE, offset=OFFSET
        )


@pytest.fixture
def scene(tmp_path):
    """120 images of 64 x 64 px; a NanoDet that detects a car at the same place with the score 0.6
    in all of them."""
    for name in ("images", "labels"):
        (tmp_path / name).mkdir()
    for i in range(120):
        cv2.imwrite(str(tmp_path / f"images/{i:03}.png"), np.full((64, 64, 3), 90, np.uint8))
        # In a quarter of the images, there is no car; in the others it is where it is detected, or
        # elsewhere.
        text = (
            ""
            if i % 4 == 0
            else "2 0.4453 0.4453 0.625 0.625\n"
            if i % 4 == 1
            else "2 0.9 0.9 0.1 0.1\n"
        )
        (tmp_path / f"labels/{i:03}.txt").write_text(text)
    outputs = []
    for stride in (8, 16, 32):
        n = (64 // stride) ** 2
        scores, bins = np.zeros((1, n, 1)), np.zeros((1, n, 32))
        if stride == 8:
            scores[0, 3 * 8 + 3] = 0.6  # centre (28, 28)
            bins.reshape(1, n, 4, 8)[:, :, :, 2] = 9.0
            bins.reshape(1, n, 4, 8)[:, :, :, 3] = 9.0  # 20 px to every side
        outputs += [scores, bins]
    write_model(tmp_path / "nano.onnx", *outputs, metadata={"names": "['car']"})
    return tmp_path


def calibrate(cli, folder, *more, model="nano.onnx"):
    inputs = (
        "--images",
        folder / "images",
        "--labels",
        folder / "labels",
        "--out",
        folder / "out.onnx",
    )
    return cli("models", "calibrate-scores", folder / model, *inputs, *more)


def test_command(scene, cli):
    status, printed, errors = calibrate(cli, scene, "--json", scene / "fit.json")
    assert status == 1, printed  # 30 matches are too few
    assert "at least 40 detections that match a label" in " ".join(errors.split())
    assert not (scene / "out.onnx").exists()
    for i in range(2, 120, 4):
        (scene / f"labels/{i:03}.txt").write_text("2 0.4453 0.4453 0.625 0.625\n")
    status, printed, errors = calibrate(cli, scene, "--json", scene / "fit.json")
    assert (status, errors) == (0, ""), errors
    assert "Not cross-validated" in printed
    figures = json.loads((scene / "fit.json").read_text())
    assert figures["n_images"] == 120
    # 60 of 120 boxes match
    assert figures["before"]["overconfidence"] == pytest.approx(0.1, abs=0.01)
    session = OnnxSession(scene / "out.onnx")
    scores = session.run(np.zeros(tuple(session.input_shape), np.float32))[0]
    assert scores.max() == pytest.approx(0.5, abs=0.02)


def test_attributes_beside_the_model_are_copied(scene, cli):
    model = onnx.load(scene / "nano.onnx")
    del model.metadata_props[:]
    onnx.save(model, scene / "nano.onnx")
    (scene / "nano.yaml").write_text("names: [car]\n")
    for i in range(2, 120, 4):
        (scene / f"labels/{i:03}.txt").write_text("2 0.4453 0.4453 0.625 0.625\n")
    status, _, errors = calibrate(cli, scene)
    assert status == 0, errors
    assert YoloDetector(scene / "out.onnx").model.names == ("car",)
    (scene / "out.yaml").write_text("names: [truck]\n")
    status, _, errors = calibrate(cli, scene)
    assert (
        status,
        "the attributes of nano.onnx, found other attributes" in " ".join(errors.split()),
    ) == (1, True)


def test_scores_that_say_nothing_are_refused(scene):
    """Random matches of scores between 0.05 and 0.95: a calibrated copy would have boxes
    everywhere."""
    rng = np.random.default_rng(0)
    samples = ScoreSamples(
        np.full(600, 2), rng.uniform(0.05, 0.95, 600), rng.uniform(size=600) < 0.3
    )
    detector = YoloDetector(scene / "nano.onnx")
    with pytest.raises(
        ModelError, match=r"images: .*of car, background would get a probability of 0\.0[3-9]"
    ):
        write_calibrated_copy(
            detector, fit_scores(samples), scene / "copy.onnx", images=scene / "images"
        )
    assert not (scene / "copy.onnx").exists()


def test_command_with_a_detector_without_score_outputs(scene, cli):
    write_model(scene / "yolo.onnx", np.zeros((1, 252, 6)), metadata={"names": "['car']"})
    status, _, errors = calibrate(cli, scene, model="yolo.onnx")
    assert (status, "expected a detector with separate outputs" in " ".join(errors.split())) == (
        1,
        True,
    )


def test_files_are_checked_before_the_work(scene, cli):
    status, _, errors = calibrate(cli, scene, "--json", scene / "no/such/folder.json")
    assert (status, "no folder" in errors) == (1, True)
    inputs = ("--images", scene / "images", "--labels", scene / "labels")
    status, _, errors = cli(
        "models", "calibrate-scores", scene / "nano.onnx", *inputs, "--out", scene / "nano.onnx"
    )
    assert (status, "expected a new file for --out" in errors) == (1, True)
