import pytest
import torch


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    """One thread for torch: more do not speed up networks of 96 pixels, and slow down tests that
    run in parallel."""
    torch.set_num_threads(1)
