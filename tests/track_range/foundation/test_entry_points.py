import shutil
from importlib import metadata

import pytest

from track_range.foundation.entry_points import entry_points


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Writes a package with an entry point of the group `things`; returns its folder."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(name):
        folder = tmp_path / f"{name}-1.0.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (folder / "entry_points.txt").write_text(f"[things]\n{name} = module:{name}\n")
        return folder

    return write


def names():
    return sorted(point.name for point in entry_points("things"))


def test_packages_come_and_go(package):
    assert names() == []
    folder = package("first")
    assert names() == ["first"]
    package("second")
    assert names() == ["first", "second"]
    shutil.rmtree(folder)
    assert names() == ["second"]


def test_packages_are_read_once(package, monkeypatch):
    package("first")
    assert names() == ["first"]
    monkeypatch.setattr(metadata, "entry_points", None)
    assert names() == ["first"]
