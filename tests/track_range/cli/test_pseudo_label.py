"""The command `pseudo-label` on drawn scenes, with networks of constant outputs."""

import contextlib
import signal

import numpy as np
import pytest
import yaml

from tests.detection.training.road_scenes import write_data_set
from tests.support.error_messages import MAX_MESSAGE
from tests.support.networks.onnx_models import write_model
from track_range.detection.training.data_yaml import read_data_yaml

N_LABELLED, N_UNLABELLED = 40, 2
"""Number of training images in which cars are labelled completely, and of the others."""

CENTRAL_CAR = "0 0.5 0.5 0.25 0.2\n"
"""Label of a car in the middle of an image, which is that of the mirror image too."""


def write_network(path, score, *, names=("car", "person")):
    """A network that detects a car in the middle of all images of 160 x 120."""
    rows = np.zeros((1, 3 * (20 * 20 + 10 * 10 + 5 * 5), 5 + len(names)))
    rows[0, 0] = [80, 80, 40, 24, 1, score, *[0] * (len(names) - 1)]  # under 20 rows of padding
    return write_model(
        path, rows, metadata={"names": str(list(names))}, input_shape=(1, 3, 160, 160)
    )


@pytest.fixture
def drawn(tmp_path):
    """Data set with a car in the middle of 30 of the 40 images in which cars are labelled
    completely."""
    path = write_data_set(tmp_path, n_train=N_LABELLED + N_UNLABELLED, n_val=4)
    manifest = ["file,split,labels_complete"]
    for split, n in (("train", N_LABELLED + N_UNLABELLED), ("val", 4)):
        for i in range(n):
            name = f"{split}-{i:03}"  # a manifest has one row per name
            (tmp_path / "images" / split / f"{i:03}.png").rename(
                tmp_path / "images" / split / f"{name}.png"
            )
            (tmp_path / "labels" / split / f"{i:03}.txt").unlink()
            (tmp_path / "labels" / split / f"{name}.txt").write_text(
                CENTRAL_CAR if i % 4 and i < N_LABELLED else ""
            )
            manifest.append(f"{name}.png,{split},{'11111111' if i < N_LABELLED else '11011111'}")
    (tmp_path / "manifest.csv").write_text("\n".join(manifest) + "\n")
    return changed(path, manifest="manifest.csv")


def changed(path, **changes):
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | changes))
    return path


def pseudo_label(cli, data, out, *options):
    return cli("pseudo-label", "--data", data, "--out", out, "--threads", 1, *options)


def test_labels_with_the_probability_of_the_matches(drawn, tmp_path, cli):
    models = [
        write_network(tmp_path / f"{name}.onnx", score) for name, score in (("a", 0.8), ("b", 0.6))
    ]
    out = tmp_path / "soft"
    status, printed, complaint = pseudo_label(
        cli, drawn, out, "--model", models[0], "--model", models[1]
    )
    assert (status, complaint) == (0, "")
    files = sorted(out.iterdir())
    assert [file.name for file in files] == [
        f"train-{i:03}.txt" for i in range(N_LABELLED + N_UNLABELLED)
    ]
    number, *cxcywh, probability = map(float, files[-1].read_text().split())
    assert number == 0
    assert cxcywh == pytest.approx([0.5, 0.5, 0.25, 0.2])
    assert probability == pytest.approx(0.75, abs=0.01)  # 30 of 40 images
    # where cars are labelled completely, a box without a label is ignored
    texts = [file.read_text() for file in files[:N_LABELLED]]
    assert [bool(text) for text in texts] == [i % 4 == 0 for i in range(N_LABELLED)]
    table = [line.split() for line in printed.splitlines() if line.startswith("car")]
    assert table[0] == ["car", "30", "2", "2", "2", "10"]
    assert " ".join(table[1]) == "car - - - 75 / 75 (4) -"
    keys = yaml.safe_load("\n".join(printed.splitlines()[-3:]))
    assert keys == {
        "labels_pseudo": "soft",
        "pseudo_scores": "probabilities",
        "pseudo_names": ["person", "car"],
    }
    truth = read_data_yaml(changed(drawn, **keys)).train[-1].truth
    assert truth.is_complete.all()
    assert truth.confidence == pytest.approx([0.75], abs=0.01)


def test_detections_of_another_detector(drawn, tmp_path, cli):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / f"train-{N_LABELLED:03}.txt").write_text(
        "0 0.5 0.5 0.25 0.2 0.75\n0 0.1 0.5 0.1 0.2 0.4\n"
    )
    changed(drawn, labels_pseudo="other")
    model = write_network(tmp_path / "a.onnx", 0.8)
    status, printed, _ = pseudo_label(cli, drawn, tmp_path / "soft", "--model", model)
    assert (status, "2 detections in labels_pseudo" in printed) == (0, True)
    both, none = (
        (tmp_path / "soft" / f"train-{N_LABELLED + i:03}.txt").read_text().split() for i in range(2)
    )
    assert [float(both[i]) for i in (5, 11)] == pytest.approx([0.75, 0.75 * 0.4], abs=0.01)
    assert float(none[5]) == pytest.approx(1 / (1 + (3 * 0.12 / 0.88) ** -0.5), abs=0.01)


@contextlib.contextmanager
def interrupt_after(n_files, folder):
    """Context in which SIGINT is raised once the folder contains a number of stored files."""

    def poll(*_):
        if sum(1 for _ in folder.rglob("train-*.npy")) >= n_files:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.raise_signal(signal.SIGINT)

    before = signal.signal(signal.SIGALRM, poll)
    signal.setitimer(signal.ITIMER_REAL, 0.001, 0.001)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_resume_and_no_overwriting(drawn, tmp_path, cli):
    out, model = tmp_path / "soft", write_network(tmp_path / "a.onnx", 0.8)
    status, _, complaint = pseudo_label(cli, drawn, out, "--model", model, "--resume")
    assert (status, "omit --resume" in complaint) == (1, True)
    with interrupt_after(5, out):
        status, _, complaint = pseudo_label(cli, drawn, out, "--model", model)
    assert (status, "--resume" in complaint, complaint.count("\n")) == (1, True, 1)
    stored = sorted(out.rglob("train-000-*.npy"))
    assert len(stored) == 1
    assert 5 <= len(list(out.rglob("train-*.npy"))) < N_LABELLED
    status, _, complaint = pseudo_label(cli, drawn, out, "--model", model)
    assert (status, "--resume" in complaint) == (1, True)
    np.save(stored[0], np.load(stored[0]) + np.float32([0.25, 0, 0.25, 0, 0, 0]))
    assert pseudo_label(cli, drawn, out, "--model", model, "--resume")[0] == 0
    assert (out / "train-000.txt").read_text().split()[1] == "0.750000"  # stored boxes are used
    assert sorted(file.suffix for file in out.iterdir()) == [".txt"] * (N_LABELLED + N_UNLABELLED)
    status, _, complaint = pseudo_label(cli, drawn, out, "--model", model)
    assert (status, "choose another --out" in complaint) == (1, True)


def test_detectors_that_find_no_labels(drawn, tmp_path, cli):
    wrong, right = (
        write_network(tmp_path / "b.onnx", 0.8, names=("bus", "car")),
        write_network(tmp_path / "c.onnx", 0.8),
    )
    out = tmp_path / "soft"
    status, _, complaint = pseudo_label(cli, drawn, out, "--model", wrong)
    assert (status, "found 0" in complaint, "other detectors" in complaint) == (1, True, True)
    assert ("delete the --out folder" in complaint, len(complaint) <= MAX_MESSAGE) == (True, True)
    status, _, complaint = pseudo_label(cli, drawn, out, "--model", right)
    assert (status, "delete the folder" in complaint) == (1, True)
    assert pseudo_label(cli, drawn, out, "--model", right, "--resume")[0] == 0


def test_output_folder_is_checked_before_models_are_loaded(drawn, tmp_path, cli):
    (tmp_path / "file").write_text("kept")
    status, _, complaint = pseudo_label(cli, drawn, tmp_path / "file", "--model", "no_such_model")
    assert (status, "expected a folder" in complaint, "no_such_model" in complaint) == (
        1,
        True,
        False,
    )


def test_resume_with_fewer_images(drawn, tmp_path, cli):
    out, model = tmp_path / "soft", write_network(tmp_path / "a.onnx", 0.8)
    (out / "detections").mkdir(parents=True)
    for name in ("train-000", "removed"):  # the run was stopped while it wrote labels
        (out / f"{name}.txt").write_text("0 0.5 0.5 0.25 0.2 0.75\n")
    status, _, complaint = pseudo_label(cli, drawn, out, "--model", model, "--resume")
    assert (status, "found 1 label of other images, such as removed.txt" in complaint) == (1, True)
    assert len(complaint) <= MAX_MESSAGE
    (out / "removed.txt").unlink()
    assert pseudo_label(cli, drawn, out, "--model", model, "--resume")[0] == 0
    assert len(list(out.iterdir())) == N_LABELLED + N_UNLABELLED


def test_damaged_images_and_dependent_validation(drawn, tmp_path, cli):
    changed(drawn, manifest=None, val="images/train")
    (tmp_path / "images/train/train-003.png").write_bytes(b"junk")
    model = write_network(tmp_path / "a.onnx", 0.8)
    status, printed, _ = pseudo_label(cli, drawn, tmp_path / "soft", "--model", model)
    assert status == 0
    assert "1 image cannot be read" in printed
    assert "train-003.png: " in printed
    assert "not an independent test" in printed
    # without a manifest, all classes are labelled completely
    assert "only boxes to ignore" in printed
    assert not (tmp_path / "soft/train-003.txt").exists()


@pytest.mark.parametrize(
    ("names", "options", "status", "message"),
    [
        (("car",), ("--model", "no_such_model"), 1, "no_such_model"),
        (
            ("stop sign", "bus"),
            (),
            1,
            "data.yaml: expected class names that the detectors have, found car, person",
        ),
        (("zebra",), (), 1, "none of its classes"),
        (("person",), (), 1, "at least 20 labels"),
        (("bus", "car"), (), 1, "at least 20 labels"),
        (("car",), ("--min-probability", 1.5), 2, "--min-probability"),
    ],
)
def test_unusable_detectors_and_options(drawn, tmp_path, cli, names, options, status, message):
    model = write_network(tmp_path / "a.onnx", 0.8, names=names)
    actual, _, complaint = pseudo_label(cli, drawn, tmp_path / "soft", "--model", model, *options)
    assert (actual, message in complaint) == (status, True)
    assert "Traceback" not in complaint
