"""depth.tar: 16-bit depths of every frame and method, whole after a failed write and a kill."""

import tarfile

import cv2
import numpy as np
import pytest

from tests.support.results.frame_results import changed, result, writing
from track_range.ranging.measurement.dense_map import DenseMap, MapPair
from track_range.ranging.measurement.rig_scale import DisparityOffset, RigScale
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

HW = (120, 160)
DEPTH = np.full((30, 40), 12.5, np.float32)
DEPTH[0, :5] = [np.nan, 300.0, 0.001, 255.99, 7.0]


def frame(index, **dense):
    return changed(result(index), dense=dense)


def read(path):
    """Arrays of counts by name in the archive."""
    with tarfile.open(path) as tar:
        files = {member.name: tar.extractfile(member).read() for member in tar}
    return {
        name: cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        for name, data in files.items()
    }


def test_counts_by_hand(tmp_path):
    with writing(tmp_path, ("depth",)) as files:
        files.write(frame(0, sgbm=DenseMap(DEPTH, "depth", HW)))
        files.write(frame(1))
        files.write(
            frame(
                2, a=DenseMap(1 / DEPTH, "inverse_depth", HW), b=DenseMap(DEPTH, "depth", HW, False)
            )
        )
    images = read(tmp_path / "depth.tar")
    assert list(images) == ["sgbm/000000.png", "a/000002.png"]  # b is not in metres
    for counts in images.values():
        assert counts.dtype == np.uint16
        assert counts.shape == (30, 40)
        assert counts[0, :5].tolist() == [0, 65535, 1, 65533, 1792]
        assert (counts[1:] == 3200).all()


def test_disparities_are_metres_with_all_corrections(tmp_path):
    rig = StereoRig.rectified(PinholeCamera(400.0, 400.0, 79.5, 59.5, HW[1], HW[0]), 0.5)
    alignment = Alignment(offset_px=1.0)
    offset = DisparityOffset(1.0, 0.1, 0.1, 200.0)
    dense = DenseMap(
        np.full((30, 40), 18.0, np.float32),
        "disparity",
        HW,
        pair=MapPair(rig, alignment),
        scale=RigScale(np.log(2.0), 0.1, offset),
    )
    with writing(tmp_path, ("depth",)) as files:
        files.write(frame(0, sgbm=dense.stretched(np.log(1.25))))
    counts = read(tmp_path / "depth.tar")["sgbm/000000.png"]
    assert np.unique(counts) == pytest.approx([256 * 200 / 20 / 2 / 1.25])


def test_a_frame_is_whole_or_absent(tmp_path):
    with writing(tmp_path, ("depth",)) as files:
        files.write(frame(0, sgbm=DenseMap(DEPTH, "depth", HW)))
        files.write(frame(1, sgbm=DenseMap(DEPTH, "depth", HW)))
        files.discard_last()
        (tmp_path / "killed.tar").write_bytes((tmp_path / "depth.tar").read_bytes())
        files.write(frame(1, sgbm=DenseMap(DEPTH + 1, "depth", HW)))
    assert list(read(tmp_path / "killed.tar")) == ["sgbm/000000.png"]
    images = read(tmp_path / "depth.tar")
    assert list(images) == ["sgbm/000000.png", "sgbm/000001.png"]
    assert images["sgbm/000001.png"][5, 5] == 3456
