import pytest
import torch

from tests.detection.training.road_scenes import write_data_set
from track_range.detection.training.data.data_set import CachedImages, TrainingSets
from track_range.detection.training.data_yaml import read_data_yaml


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    """One thread for torch: more do not speed up networks of 96 pixels, and slow down tests that
    run in parallel."""
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def sets(tmp_path_factory):
    """Drawn road scenes: 12 images to train with, 4 to validate."""
    data = read_data_yaml(write_data_set(tmp_path_factory.mktemp("drawn"), n_train=12, n_val=4))
    train, val = (CachedImages(items, data.road_class_id) for items in (data.train, data.val))
    return TrainingSets(train, val, data.road_class_id)
