import cv2
import numpy as np
import pytest

from track_range.detection.training.data_yaml import read_data_yaml
from track_range.simulation.simulate import write_image_set


@pytest.mark.slow
def test_image_set_is_a_data_set(tmp_path):
    steps = []
    path = write_image_set(
        tmp_path, [1000, 1001], n_frames=2, progress=lambda done, total: steps.append((done, total))
    )
    assert steps == [(1, 4), (2, 4), (3, 4), (4, 4)]
    data = read_data_yaml(path)
    assert len(data.train) == 4
    names = {int(i) for item in data.train for i in item.truth.class_id}
    assert {0, 2} <= names  # people and cars
    assert any(item.truth.is_ignored.any() for item in data.train)  # something is always hidden
    image = cv2.imread(str(data.train[0].path))
    assert image.shape == (194, 640, 3)
    boxes = np.concatenate([item.truth.xyxy_px[~item.truth.is_ignored] for item in data.train])
    assert len(boxes) > 20
    assert ((boxes[:, 2:] - boxes[:, :2]) * [640, 194] >= 2.9).all()


@pytest.mark.slow
def test_same_seeds_give_the_same_files(tmp_path):
    for name in ("a", "b"):
        write_image_set(tmp_path / name, [7], n_frames=1)
    files = [
        sorted(path.relative_to(tmp_path / n) for path in (tmp_path / n).rglob("*.*"))
        for n in ("a", "b")
    ]
    assert files[0] == files[1]
    assert all(
        (tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files[0]
    )
