"""Registry: names and precedence of built-in, registered and installed things, and what is
imported."""

import shutil
from contextlib import suppress
from importlib import metadata

import pytest

from track_range.foundation.registry import Registry, imported


@pytest.fixture
def things():
    return Registry("things", {"own": "os.path:join", "other": "os:sep"})


def test_packages_come_and_go(things, install):
    assert things.names == ("own", "other")
    folder = install("things", first="module:first")
    assert things.names == ("own", "other", "first")
    install("things", a="module:a")
    assert things.names == ("own", "other", "a", "first")
    shutil.rmtree(folder)
    assert things.names == ("own", "other", "a")


def test_packages_are_read_once(things, install, monkeypatch):
    install("things", first="module:first")
    assert things.names[2:] == ("first",)
    monkeypatch.setattr(metadata, "entry_points", None)
    assert things.names[2:] == ("first",)


def test_precedence(things, install):
    install("things", own="module:another", late="module:late", packaged="module:packaged")
    with things.restored():
        things.registered |= {"own": 1, "late": 2}
        assert things.names == ("own", "other", "late", "packaged")
        found = [things.find(name) for name in ("own", "late", "packaged", "none")]
        assert found == ["os.path:join", 2, "module:packaged", None]
    assert things.names == ("own", "other", "late", "packaged")
    assert things.find("late") == "module:late"
    assert things.registered == {}


def test_registrations_end_with_an_error(things):
    with suppress(KeyError), things.restored():
        things.registered["late"] = 1
        raise KeyError
    assert things.find("late") is None


def test_imported():
    assert imported("collections.abc:Mapping.get").__qualname__ == "Mapping.get"
    assert imported(5) == 5


@pytest.mark.parametrize("text", ["no_such_module:x", "os:no_such_name", "os:", "os", ":x", ""])
def test_nothing_to_import(text):
    with pytest.raises((ImportError, AttributeError, ValueError)):
        imported(text)
