"""`fit --depth-model`: the errors of a network on labelled drives, by its factor in each of them."""

import re

import cv2
import numpy as np
import pytest
import yaml

from tests.support.networks.depth_networks import encoded, write_depth
from tests.support.recordings.label_rows import CX_PX, CY_PX, F_PX, label_row
from track_range.evaluation.network_errors import write_errors
from track_range.ranging.fitting.network_fit import FittedNetwork
from track_range.ranging.networks.network import open_depth_network
from track_range.ranging.size_models.network_scale import NetworkErrors

pytestmark = pytest.mark.slow

WIDTH_PX, HEIGHT_PX, N_FRAMES = 1240, 376, 16
DRIVES = {"0000": 0.6, "0001": 0.75, "0002": 0.9, "0003": 0.7}
PEDESTRIANS, TRACK_SIGMA, NOISE_SIGMA = 0.85, 0.08, 0.04
CAMERA = {
    "fx_px": F_PX,
    "fy_px": F_PX,
    "cx_px": CX_PX,
    "cy_px": CY_PX,
    "width_px": WIDTH_PX,
    "height_px": HEIGHT_PX,
    "distortion": [],
}
RIG = {
    "track_range_rig": 1,
    "left": CAMERA,
    "right": CAMERA,
    "right_from_left": {
        "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        "translation_m": [-0.54, 0.0, 0.0],
    },
}


def write_drive(folder, name, factor, rng, *, power=1.0):
    """Labels, calibration and images of eight objects, whose pixels encode what the network sees."""
    for place in ("labels", "calib", f"images/{name}"):
        (folder / place).mkdir(parents=True, exist_ok=True)
    kinds = ["Car", "Pedestrian"] * 4
    first_m = rng.permutation(np.geomspace(9, 45, len(kinds)))
    of_track = np.exp(rng.normal(0, TRACK_SIGMA, len(kinds)))
    rows = []
    for frame in range(N_FRAMES):
        depth = np.full((HEIGHT_PX, WIDTH_PX), 80.0)
        for track in np.argsort(-first_m):
            rear_m, across = first_m[track] + 0.3 * frame, (track - 3.5) * 0.1
            row = label_row(frame, track, kinds[track], rear_m, x_m=across * rear_m)
            x1, y1, x2, y2 = (round(float(value)) for value in row.split()[6:10])
            seen_m = factor * of_track[track] * 10 * (rear_m / 10) ** power
            seen_m *= PEDESTRIANS if kinds[track] == "Pedestrian" else 1.0
            depth[y1 : y2 + 1, x1 : x2 + 1] = seen_m * np.exp(rng.normal(0, NOISE_SIGMA))
            rows.append(row)
        image = f"{folder}/images/{name}/{frame:06d}.png"
        assert cv2.imwrite(image, encoded(depth), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    (folder / "labels" / f"{name}.txt").write_text("\n".join(rows) + "\n")
    (folder / "calib" / f"{name}.txt").write_text(yaml.safe_dump(RIG))


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("drives"), np.random.default_rng(4)
    for name, factor in DRIVES.items():
        write_drive(folder, name, factor, rng)
    return folder


def fit(cli, folder, model, *more):
    places = [("--labels", "labels"), ("--calib", "calib"), ("--images", "images")]
    options = [part for flag, place in places for part in (flag, folder / place)]
    return cli("fit", "--depth-model", model, *options, *more)


def test_fit_recovers_the_errors_of_a_network(drives, cli, tmp_path):
    model = write_depth(tmp_path / "net.onnx")
    status, out, complaint = fit(cli, drives, model)
    assert status == 0, complaint
    errors = open_depth_network(model).format.errors
    logs = np.log(list(DRIVES.values())) + np.log(PEDESTRIANS) / 2
    assert errors.log_factor == pytest.approx(logs.mean(), abs=0.06)
    assert errors.drive_sigma == pytest.approx(logs.std(ddof=1), rel=0.5)
    ratio = errors.class_factors["person"] / errors.class_factors["car"]
    assert ratio == pytest.approx(PEDESTRIANS, abs=0.06)
    assert errors.track_sigma == pytest.approx(TRACK_SIGMA, rel=0.4)
    assert errors.noise_sigma == pytest.approx(NOISE_SIGMA, rel=0.3)
    assert errors.slope == pytest.approx(1.0, abs=0.1)
    assert "sequences 0000, 0001, 0002, 0003" in errors.source
    for name in (*DRIVES, "car", "person", "track"):
        assert name in out
    text = model.with_suffix(".yaml").read_text()
    assert yaml.safe_load(text)["gives"] == "depth"  # what the file had before


def test_errors_of_left_out_sequences_are_within_their_sigma(drives, cli, tmp_path):
    status, out, _ = fit(cli, drives, write_depth(tmp_path / "net.onnx"))
    assert status == 0
    rows = [re.findall(r"[\d.]+", line) for line in out.splitlines() if "000" in line]
    within = [float(row[-1]) for row in rows if row and row[0] in DRIVES]
    assert len(within) == len(DRIVES)
    assert np.mean(within) > 85


def test_network_that_compresses_distances_has_its_slope(cli, tmp_path):
    rng = np.random.default_rng(1)
    for name in ("0000", "0001"):
        write_drive(tmp_path, name, 1.0, rng, power=0.5)
    model = write_depth(tmp_path / "net.onnx")
    status, out, complaint = fit(cli, tmp_path, model)
    assert status == 0, complaint
    assert open_depth_network(model).format.errors.slope == pytest.approx(0.5, abs=0.15)
    assert "give more sequences" in " ".join(out.split())


def test_relative_network_and_missing_labels_are_refused(drives, cli, tmp_path):
    relative = write_depth(
        tmp_path / "relative.onnx", gives="inverse_depth", settings="metric: false"
    )
    status, _, complaint = fit(cli, drives, relative)
    assert status == 1
    assert "scale and a shift" in " ".join(complaint.split())
    status, _, complaint = cli("fit", "--depth-model", relative)
    assert status
    assert "--labels" in complaint
    status, _, complaint = fit(cli, drives, relative, "--leave-out", "0009")
    assert "0009" in complaint


def test_errors_of_a_file_that_needs_no_settings_keep_its_format(tmp_path):
    network = open_depth_network(write_depth(tmp_path / "net.onnx", gives="inverse_depth"))
    network.path.with_suffix(".yaml").unlink()
    errors = NetworkErrors(factor=0.7, class_factors={"car": 1.1}, slope=0.9)
    assert write_errors(network, FittedNetwork(errors, ())) == tmp_path / "net.yaml"
    again = open_depth_network(network.path).format
    assert again.errors == errors
    assert again.model_copy(update={"errors": None}) == network.format
