"""What SECURITY.md promises about code: the current folder is searched only for modules that
`--tracker` names."""

import sys

import pytest

from track_range.foundation.processes import owned_process
from track_range.tracking.registry import TrackerError, create_tracker

TRACKER = """
class Own:
    def __init__(self, options): ...
    def update(self, detections, time_s, image): ...
"""


@pytest.fixture
def current_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if folder])
    yield tmp_path
    sys.modules.pop("tracker_of_the_folder", None)


def test_tracker_of_the_current_folder(current_folder):
    (current_folder / "tracker_of_the_folder.py").write_text(TRACKER, encoding="utf-8")
    with owned_process():  # as the command line and the workers of a fleet
        create_tracker("sort")
        assert str(current_folder) not in sys.path
        assert type(create_tracker("tracker_of_the_folder:Own")).__name__ == "Own"


def test_current_folder_is_searched_last(current_folder):
    (current_folder / "colorsys.py").write_text("raise SystemExit(9)", encoding="utf-8")
    with pytest.raises(TrackerError), owned_process():
        create_tracker("colorsys:NoTracker")
    assert sys.path[-1] == str(current_folder)


def test_library_does_not_search_the_current_folder(current_folder):
    (current_folder / "tracker_of_the_folder.py").write_text(TRACKER, encoding="utf-8")
    with owned_process():
        pass
    with pytest.raises(TrackerError, match="tracker_of_the_folder"):
        create_tracker("tracker_of_the_folder:Own")
    assert str(current_folder) not in sys.path
