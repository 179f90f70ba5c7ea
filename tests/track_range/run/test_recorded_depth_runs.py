"""Runs of bags with recorded depth: the method `recorded`, its columns, its part in the fused
distance, and depth.tar."""

import json
import tarfile

import av
import cv2
import numpy as np
import pytest

from tests.support.networks.depth_networks import write_depth
from tests.track_range.recording.depth_bags import ImageTopic, write_bag
from track_range.results.formats.csv_file import read_tracks_csv
from track_range.simulation.drive import write_drive
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario

SEED, SECONDS, FPS = 5, 1.2, 10.0


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A drive, and a bag of its left images with their exact depth in millimetres."""
    folder = tmp_path_factory.mktemp("depth")
    rig = kitti_like_rig(width_px=620, height_px=188)
    files = write_drive(folder, scenario="town", seed=SEED, seconds=SECONDS, fps=FPS, rig=rig)
    scene = make_scenario("town", seed=SEED, seconds=SECONDS)
    renderer = Renderer(scene, rig)
    times_s = np.arange(round(SECONDS * FPS)) / FPS
    images = [renderer.render(time_s) for time_s in times_s.tolist()]
    depth = [np.clip(renderer.depth_m(time_s), 0, 65) for time_s in times_s.tolist()]
    millimetres = [np.where(z < 65, np.rint(1000 * z), 0).astype(np.uint16) for z in depth]
    k = rig.left.matrix.ravel().tolist()
    size = {"width": 620, "height": 188}
    colour = ImageTopic(
        name="/zed/left/image",
        encoding="bgr8",
        images=images,
        info="/zed/left/camera_info",
        k=k,
        info_fields=size,
    )
    aligned = ImageTopic(name="/zed/depth/depth_registered", encoding="16UC1", images=millimetres)
    return files, write_bag(folder / "bag", [colour, aligned])


@pytest.fixture
def run(cli, tmp_path, drive):
    files, bag = drive

    def run_bag(*arguments, name="out"):
        status, printed, errors = cli(
            *("run", "--mono", bag, "--detections", files.detections, "--truth", files.truth),
            *("--out", tmp_path / name, *(arguments or ("--no-overlay",))),
        )
        assert status == 0, errors
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        return read_tracks_csv(tmp_path / name / "tracks.csv"), summary, " ".join(printed.split())

    return run_bag


@pytest.mark.slow
def test_recorded_depth_is_a_method_of_the_run(run):
    rows, summary, printed = run()
    assert "depth_registered is the ranging method `recorded`" in printed
    recorded = summary["methods"]["recorded"]
    assert recorded["coverage"] > 0.5
    assert recorded["n"] > 20
    assert recorded["median_relative_error_pct"] < 2.0
    known = np.isfinite(rows["recorded_m"])
    z, sigma_m = rows["recorded_m"][known], rows["recorded_sigma_m"][known]
    assert (sigma_m >= np.hypot(0.005 * z, 0.0055 * z**2)).all()
    # it is fused where it is more precise than sizes are
    assert summary["methods"]["fused"]["median_relative_error_pct"] < 3.0


@pytest.mark.slow
def test_it_can_be_shown_only_or_left_out(run):
    rows, _, _ = run("--show-only", "recorded", "--no-overlay")
    without, _, _ = run("--methods", "mono,ground,lane,expansion", "--no-overlay", name="without")
    assert np.isfinite(rows["recorded_m"]).any()
    assert "recorded_m" not in without


@pytest.mark.slow
def test_depth_of_a_network_below_the_overlay_and_in_depth_tar(run, drive, tmp_path):
    """One camera, a network that sees 20 m everywhere, and the recorded depth."""
    write_depth(tmp_path / "net.onnx", constant=20.0)
    status = run(
        *("--depth-model", tmp_path / "net.onnx", "--write", "csv,depth"),
        *("--overlay", "--overlay-disparity"),
    )
    assert "depth.tar has no depths" not in status[2]
    with av.open(str(tmp_path / "out/overlay.mp4")) as film:
        picture = next(film.decode(video=0)).to_ndarray(format="bgr24")
    assert picture.shape == (376, 620, 3)
    assert picture[250].std(axis=0).max() < 60  # one colour, but for boxes
    with tarfile.open(tmp_path / "out/depth.tar") as tar:
        names = tar.getnames()
        counts = {name: tar.extractfile(name).read() for name in names[:2]}
    assert names[:2] == ["depth/000000.png", "recorded/000000.png"]
    of_network, of_camera = (
        cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) / 256
        for data in counts.values()
    )
    assert 10 < np.unique(of_network).item() < 40  # corrected by what the drive shows
    assert np.median(of_camera[170]) == pytest.approx(np.median(of_camera[170:173]), rel=0.1)
    assert 2 < np.median(of_camera[170]) < 12  # the road in front
