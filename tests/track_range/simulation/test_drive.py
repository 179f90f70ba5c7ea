"""The files of a drive, read back by the readers of the rest of the program."""

import numpy as np
import pytest

from detection.kitti_format import read_kitti
from stereo.rig_files import load_rig
from track_range.simulation.drive import kitti_text, write_drive
from track_range.simulation.render import Renderer, kitti_like_rig
from track_range.simulation.scene import make_scene
from track_range.simulation.truth import label_scene
from track_range.video import VideoReader

SMALL = kitti_like_rig(width_px=310, height_px=94)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    calls = []
    folder = tmp_path_factory.mktemp("drive") / "new"
    written = write_drive(
        folder, seed=3, seconds=0.4, rig=SMALL, progress=lambda done, total: calls.append((done, total))
    )
    return written, calls


def test_progress_counts_every_frame(drive):
    assert drive[1] == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_the_videos_show_the_scene(drive):
    renderer = Renderer(make_scene(3, seconds=0.4), SMALL)
    for path, eye in ((drive[0].left, "left"), (drive[0].right, "right")):
        frames = list(VideoReader(path))
        np.testing.assert_allclose([frame.time_s for frame in frames], [0.0, 0.1, 0.2, 0.3], atol=1e-4)
        image = frames[3].image.astype(float)
        wanted = renderer.render(0.3, eye=eye)
        # Compared in grey: the codec halves the colours' resolution.
        assert np.abs(image.mean(axis=2) - wanted.mean(axis=2)).mean() < 3.0


def test_the_rig_reads_back(drive):
    rig, _ = load_rig(drive[0].rig, size_px=(310, 94))
    assert rig.left == SMALL.left
    assert rig.baseline_m == pytest.approx(0.54)
    assert rig.is_rectified


def test_the_truth_reads_back(drive):
    labels = read_kitti(drive[0].truth)
    wanted = label_scene(make_scene(3, seconds=0.4), [0.0, 0.1, 0.2, 0.3], camera=SMALL.left)
    assert labels.kitti_type.tolist() == wanted.kitti_type.tolist()
    np.testing.assert_array_equal(labels.track_id, wanted.track_id)
    np.testing.assert_allclose(labels.xyxy_px, wanted.xyxy_px, atol=1e-6)
    np.testing.assert_allclose(labels.location_m, wanted.location_m, atol=1e-6)
    assert set(labels.frame.tolist()) == {0, 1, 2, 3}


def test_the_detections_read_back(drive):
    found = read_kitti(drive[0].detections)
    assert len(found) > 10
    assert np.isfinite(found.score).all()
    assert not found.has_3d_box.any()
    words = drive[0].detections.read_text().split("\n")[0].split()
    assert words[3:6] == ["-1", "-1", "-10"]
    assert words[10:17] == ["-1", "-1", "-1", "-1000", "-1000", "-1000", "-10"]


def test_the_same_seed_writes_the_same_bytes(drive, tmp_path):
    again = write_drive(tmp_path, seed=3, seconds=0.4, rig=SMALL)
    for name in ("truth", "detections", "rig", "left", "right"):
        assert getattr(again, name).read_bytes() == getattr(drive[0], name).read_bytes(), name
    other = label_scene(make_scene(4, seconds=0.4), [0.0], camera=SMALL.left)
    assert kitti_text(other) not in drive[0].truth.read_text()


def test_alpha_is_the_heading_less_the_bearing():
    labels = label_scene(make_scene(0), [0.0], camera=kitti_like_rig().left)
    labels = labels.select(labels.has_3d_box)
    alpha = [float(line.split()[5]) for line in kitti_text(labels).splitlines()]
    x, _, z = labels.location_m.T
    # Seen from the object, the viewing ray and its heading: the same angle on the unit circle.
    np.testing.assert_allclose(
        np.exp(1j * np.array(alpha)), np.exp(1j * (labels.rotation_y_rad - np.arctan2(x, z))), atol=1e-5
    )
    assert np.abs(alpha).max() <= np.pi + 1e-6


def test_a_drive_without_a_frame_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"at least one frame wanted, 0\.01 s at 10 frames/s got"):
        write_drive(tmp_path, seconds=0.01)
