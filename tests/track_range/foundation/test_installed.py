"""Packages that come in several distributions."""

import importlib.metadata

import pytest

from track_range.foundation import installed
from track_range.foundation.installed import conflicts, installed_versions


@pytest.fixture(autouse=True)
def only(monkeypatch):
    """Sets which distributions are installed."""

    def versions(**found):
        def version(name):
            if name not in found:
                raise importlib.metadata.PackageNotFoundError(name)
            return found[name]

        monkeypatch.setattr(installed, "version", version)
        conflicts.cache_clear()

    yield lambda found: versions(**found)
    conflicts.cache_clear()


@pytest.mark.parametrize(
    ("found", "opencv", "words"),
    [
        ({"opencv-python-headless": "5.0"}, ["opencv-python-headless"], None),
        (
            {"opencv-contrib-python": "5.0", "onnxruntime-gpu": "1.31"},
            ["opencv-contrib-python"],
            None,
        ),
        ({"numpy": "2.0"}, [], None),
        (
            {"opencv-python": "4.9", "opencv-python-headless": "5.0"},
            ["opencv-python-headless", "opencv-python"],
            "opencv-python-headless 5.0 and opencv-python 4.9 are installed and overwrite each "
            "other's files: pip uninstall -y opencv-python-headless opencv-python, then pip "
            "install the package that you need.",
        ),
        (
            {"onnxruntime": "1.32", "onnxruntime-openvino": "1.24"},
            [],
            "onnxruntime 1.32 and onnxruntime-openvino 1.24",
        ),
    ],
)
def test_distributions_of_one_package(only, found, opencv, words):
    only(found)
    assert list(installed_versions("opencv-python-headless")) == opencv
    assert [words in note for note in conflicts()] == ([] if words is None else [True])


def test_other_packages(only):
    only({"numpy": "2.0"})
    assert (installed_versions("numpy"), installed_versions("scipy")) == ({"numpy": "2.0"}, {})
