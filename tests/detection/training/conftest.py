import pytest
import torch


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    """Networks of 96 pixels gain nothing from threads, and lose much where others want the cores too."""
    torch.set_num_threads(1)
