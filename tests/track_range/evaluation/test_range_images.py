"""`evaluate ranges --images`: methods that need pixels or a pair, on labelled boxes of a drive."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import track_range as tr
from tests.support.networks.depth_networks import encoded, write_depth, write_stereo
from tests.toys.toy_method import TOY
from track_range.foundation.errors import UsageError
from track_range.ranging import registry
from track_range.ranging.evaluation.image_methods import LabelledImageError
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import MethodError, Ranger
from track_range.ranging.truth.labelled_boxes import BoxSelection, box_set


class FrameNumbers(Ranger):
    """As distances, 10 m and the frame number, from images that are not blank."""

    def measure(self, tracks, frame):
        assert frame.left.std() > 5
        distance_m = np.full(len(tracks), 10.0 + frame.index)
        return Ranges(tracks.track_id, distance_m, 0.1 * distance_m)


NUMBERS = replace(
    TOY,
    name="numbers",
    letter="Q",
    needs=frozenset({"image"}),
    create=lambda context: FrameNumbers(),
)
EMPTY = replace(NUMBERS, name="empty", create=lambda context: None)


@pytest.fixture(autouse=True)
def _registrations():
    with registry.METHODS.restored():
        yield


@pytest.fixture(scope="module")
def folders(render_drive, tmp_path_factory):
    """Labels, calibration and images of a drive of one second, in folders."""
    drive, folder = render_drive(seed=3, seconds=1.2), tmp_path_factory.mktemp("sets")
    places = {
        "labels": (drive.truth, "seq.txt"),
        "calib": (drive.rig, "seq.txt"),
        "left": (drive.left, "seq.mp4"),
        "right": (drive.right, "seq.mp4"),
    }
    for place, (file, name) in places.items():
        (folder / place).mkdir()
        (folder / place / name).write_bytes(file.read_bytes())
    return folder


def evaluated(folders, methods, **more):
    return tr.evaluate.ranges(
        folders / "labels", folders / "calib", methods=methods, align="off", **more
    )


def pair(folders):
    return {"images": folders / "left", "right_images": folders / "right"}


def test_stereo_beside_mono_on_the_same_boxes(folders):
    figures = evaluated(folders, ["mono", "stereo", "sgbm", "mono+stereo"], **pair(folders))
    assert list(figures["methods"]) == ["mono", "stereo", "sgbm", "mono+stereo"]
    cars = {name: row["car"] for name, row in figures["methods"].items()}
    assert cars["stereo"]["coverage"] > 0.7
    assert cars["stereo"]["median_relative_error_pct"] < 3
    assert cars["sgbm"]["median_relative_error_pct"] < 5
    without = evaluated(folders, ["mono"])
    assert without["methods"]["mono"]["car"] == cars["mono"]
    assert without["comparison"] == {}
    compared = figures["comparison"]["car"]
    assert compared["n_measured"]["stereo"] == cars["stereo"]["n"]
    assert 0 < compared["n_common"] <= min(compared["n_measured"].values()) <= compared["n"]
    assert set(compared["methods"]) == set(cars)


def test_method_of_a_module_gets_the_images_of_its_frames(folders, cli, tmp_path):
    images = tmp_path / "images" / "seq"
    images.mkdir(parents=True)
    recording = tr.open_recording(folders / "left" / "seq.mp4", focal_px=360)
    for frame in recording.frames:
        cv2.imwrite(str(images / f"{frame.index:06d}.png"), frame.left)
    recording.close()
    status, printed, errors = cli(
        *("evaluate", "ranges", "--labels", folders / "labels", "--calib", folders / "calib"),
        *("--methods", f"{__name__}:NUMBERS,mono", "--images", tmp_path / "images"),
        *("--json", tmp_path / "f.json"),
    )
    assert status == 0, errors
    assert "numbers" in printed
    found = json.loads((tmp_path / "f.json").read_text())["methods"]["numbers"]["car"]
    by_video = evaluated(folders, [f"{__name__}:NUMBERS"], images=folders / "left")
    assert by_video["methods"]["numbers"]["car"] == found
    assert found["coverage"] == 1.0


def test_images_of_one_file_of_labels(folders):
    figures = tr.evaluate.ranges(
        folders / "labels" / "seq.txt",
        folders / "calib" / "seq.txt",
        methods=[f"{__name__}:NUMBERS"],
        images=folders / "left" / "seq.mp4",
    )
    assert figures["methods"]["numbers"]["car"]["coverage"] == 1.0


def test_inputs_that_methods_lack(folders):
    with pytest.raises(UsageError, match="stereo: needs right image; give images= and"):
        evaluated(folders, ["stereo"], images=folders / "left")
    with pytest.raises(UsageError, match="lane: needs lane lines, which only a run has"):
        evaluated(folders, ["lane"], images=folders / "left")
    with pytest.raises(UsageError, match=r"radar: expected .*mono, .*package\.module:OBJECT"):
        evaluated(folders, ["radar"])
    with pytest.raises(UsageError, match="images"):
        evaluated(folders, ["mono"], right_images=folders / "right")
    with pytest.raises(MethodError, match=r"'empty': expected the input .*depth.model"):
        evaluated(folders, [f"{__name__}:EMPTY"], images=folders / "left")


def test_images_that_do_not_fit_the_labels(folders, tmp_path, render_drive):
    chosen = [f"{__name__}:NUMBERS"]
    with pytest.raises(LabelledImageError, match=r"seq\.txt in a folder seq, or a video"):
        evaluated(folders, chosen, images=folders / "calib" / "..")
    labels = tmp_path / "labels"
    labels.mkdir()
    text = (folders / "labels" / "seq.txt").read_text()
    late = "".join(f"7{line}\n" for line in text.splitlines())
    (labels / "seq.txt").write_text(text + late)
    with pytest.raises(LabelledImageError, match=r"seq\.mp4: expected an image of the .* frame 7"):
        tr.evaluate.ranges(labels, folders / "calib", methods=chosen, images=folders / "left")
    (tmp_path / "calib").mkdir()
    rig = (folders / "calib" / "seq.txt").read_text()
    no_size = "\n".join(line for line in rig.splitlines() if "size" not in line)
    (tmp_path / "calib" / "seq.txt").write_text(no_size)
    (tmp_path / "small").mkdir()
    small = render_drive(seed=1, seconds=0.4, size_px=(320, 96))
    (tmp_path / "small" / "seq.mp4").write_bytes(Path(small.left).read_bytes())
    with pytest.raises(tr.errors.UserError, match="320x96"):
        evaluated(folders, chosen, images=tmp_path / "small")


def test_method_of_a_module_in_labelled_motion(folders):
    poses = np.tile([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.0], (40, 1))
    poses[:, 11] = np.arange(40)
    np.savetxt(folders / "poses.txt", poses)
    given = {"calib": folders / "calib" / "seq.txt", "poses": folders / "poses.txt"}
    labels = folders / "labels" / "seq.txt"
    by_toy, again = (
        tr.evaluate.motion(labels, **given, **{key: "tests.toys.toy_method:TOY"})
        for key in ("methods", "method")
    )
    assert by_toy["method"] == "tests.toys.toy_method:TOY"
    assert by_toy["bands"] == again["bands"] != tr.evaluate.motion(labels, **given)["bands"]


@pytest.fixture(scope="module")
def encoded_images(folders, tmp_path_factory):
    """Images in which each labelled box encodes its true distance, nearest last, on a flat road."""
    boxes = box_set(
        folders / "labels", folders / "calib", selection=BoxSelection(has_all_objects=True)
    )
    images = tmp_path_factory.mktemp("encoded")
    (images / "seq").mkdir()
    width, height = boxes.size_px[0].tolist()
    camera = boxes.camera_at(0)
    for index in range(int(boxes.frame.max()) + 1):
        below_px = np.maximum(np.arange(height) - camera.cy_px, 1.0)
        road_m = np.minimum(1.65 * camera.fy_px / below_px, 70.0)
        depth_m = np.repeat(road_m[:, None], width, axis=1)
        rows = np.flatnonzero(boxes.frame == index)
        for row in rows[np.argsort(-boxes.distance_m[rows])]:
            x1, y1, x2, y2 = np.rint(boxes.xyxy_px[row]).astype(int).clip(0)
            depth_m[y1 : y2 + 1, x1 : x2 + 1] = boxes.distance_m[row]
        cv2.imwrite(str(images / "seq" / f"{index:06d}.png"), encoded(depth_m))
    return images


def test_images_are_those_of_the_numbers_in_their_names(folders, encoded_images, tmp_path):
    (tmp_path / "seq").mkdir()
    for image in (encoded_images / "seq").glob("*.png"):
        (tmp_path / "seq" / f"{int(image.stem) + 1:06d}.png").write_bytes(image.read_bytes())
    with pytest.raises(LabelledImageError, match="labelled frame 0, found none"):
        evaluated(folders, [f"{__name__}:NUMBERS"], images=tmp_path)


def test_depth_networks_beside_mono(folders, encoded_images, tmp_path):
    """Both are corrected by the sizes of the same boxes, so that a factor of 0.7 is no error."""
    exact = write_depth(tmp_path / "exact.onnx")
    short = write_depth(tmp_path / "short.onnx", factor=0.7)
    given = {"images": encoded_images, "depth_model": [exact, short]}
    figures = evaluated(folders, ["mono"], **given)
    cars = {name: row["car"] for name, row in figures["methods"].items()}
    assert list(cars) == ["mono", "depth-exact", "depth-short"]
    for name in ("depth-exact", "depth-short"):
        assert cars[name]["coverage"] > 0.8
        assert cars[name]["median_relative_error_pct"] < 8
        assert cars[name]["within_2_sigma"] > 0.9
    assert cars["mono"] == evaluated(folders, ["mono"])["methods"]["mono"]["car"]
    fused = evaluated(folders, ["mono", "mono+depth"], images=encoded_images, depth_model=[exact])
    cars = {name: row["car"] for name, row in fused["methods"].items()}
    assert list(cars) == ["mono", "mono+depth", "depth"]
    assert cars["mono+depth"] != cars["mono"]
    assert cars["mono+depth"]["median_sigma_pct"] < cars["mono"]["median_sigma_pct"]
    with pytest.raises(UsageError, match=r"depth: needs image; give images="):
        evaluated(folders, ["mono"], depth_model=[exact])
    assert "depth" not in evaluated(folders, [])["methods"]


def test_stereo_network_beside_stereo(folders, tmp_path):
    """A network of constant disparities gives all objects one distance."""
    network = write_stereo(tmp_path / "flat.onnx", factor=0.0, offset=10.0)
    figures = evaluated(folders, ["stereo"], stereo_model=[network], **pair(folders))
    assert list(figures["methods"]) == ["stereo", "disparity"]
    cars = {name: row["car"] for name, row in figures["methods"].items()}
    assert cars["disparity"]["mean_relative_error_pct"] > 10
    assert cars["stereo"]["mean_relative_error_pct"] < 5
