"""Registry: names and precedence of built-in, registered and installed things, and what is
imported."""

import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata

import pytest

from track_range.foundation.errors import UserError
from track_range.foundation.registry import Registry, imported, plugin_notes


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


@dataclass(frozen=True)
class Reader:
    """An object of which the program chooses."""

    name: str
    priority: int = 0


ANY, SPECIAL, FIRST = Reader("any", -10), Reader("special", 10), Reader("first")
MANY = (Reader("third"), Reader("fourth", -20))
THIS = "tests.track_range.foundation.test_registry"


@pytest.fixture
def readers():
    return Registry("readers", {"any": ANY, "first": f"{THIS}:FIRST"}, Reader)


def names_of(things):
    return [thing.name for thing in things]


def test_objects_are_tried_by_priority_then_in_order(readers, install):
    install("readers", many=f"{THIS}:MANY", special=f"{THIS}:SPECIAL")
    assert [*readers.usable] == ["any", "first", "third", "fourth", "special"]
    assert names_of(readers.by_priority) == ["special", "first", "third", "any", "fourth"]
    with readers.restored():
        readers.registered["last"] = Reader("last", -30)
        assert names_of(readers.by_priority)[-1] == "last"
    assert readers.named("fourth") is MANY[1]
    assert readers.named("first") is FIRST
    with pytest.raises(KeyError):
        readers.named("last")


def test_origin_names_the_package(readers, install):
    install("readers", many=f"{THIS}:MANY")
    assert readers.usable["third"] is MANY[0]
    assert readers.origin("third") == f"{THIS}:MANY (package0 1.0)"
    assert readers.origin("any") == readers.origin("none") == ""


def test_packages_that_cannot_be_used_are_named_once_each(readers, install):
    targets = {
        "absent": "no_such_module:X",
        "missing": f"{THIS}:NONE",
        "other": "os:sep",
        "same": f"{THIS}:FIRST",
        "usable": f"{THIS}:SPECIAL",
    }
    assert readers.notes == ()  # nothing was needed yet
    install("readers", **targets)
    assert [*readers.usable] == ["any", "first", "special"]
    assert [note.split(" = ")[0] for note in readers.notes] == [
        f"Entry point {name}" for name in ("absent", "missing", "other", "same")
    ]
    assert all("(package0 1.0)" in note and "\n" not in note for note in readers.notes)
    assert set(readers.notes) <= set(plugin_notes())


def test_objects_that_do_not_fit_those_before_are_left_out(install):
    def refuse(reader, others, pending):
        if reader.priority > 0:
            raise UserError(f"{reader.name} after {len(others)} and {pending[0]}.")

    readers = Registry("readers", {"any": ANY}, Reader, refuse)
    install("readers", special=f"{THIS}:SPECIAL", whole=f"{THIS}:FIRST")
    assert [*readers.usable] == ["any", "first"]
    assert readers.notes[0].endswith("cannot be used: special after 1 and special.")


EMPTY, EQUAL = (), (Reader("twice"), Reader("twice"))
ODD = Reader("odd", "high")


@pytest.mark.parametrize(
    ("attribute", "reason"),
    [
        ("EMPTY", "got 0 without them"),
        ("EQUAL", "a name for each of 2 objects, got equal names"),
        ("ODD", "expected an integer as priority, got 'high'"),
    ],
)
def test_objects_are_not_lost_silently(readers, install, attribute, reason):
    install("readers", new=f"{THIS}:{attribute}")
    assert len(readers.by_priority) == 2
    assert reason in readers.notes[0]


@dataclass(frozen=True)
class Nameless:
    """An object with a function."""

    reads: Callable[[str], object]


NAMELESS = (Nameless(str), Nameless(str))


def _fail(text):
    if text == "known":
        raise UserError(f"{text} to be wrong.")
    yield {}[text]


FAILING = Nameless(_fail)


def test_a_tuple_needs_names(install):
    registry = Registry("nameless", {}, Nameless)
    install("nameless", two=f"{THIS}:NAMELESS")
    assert not registry.usable
    assert "got 2 without them" in registry.notes[0]


def test_a_failing_function_names_its_package(install):
    registry = Registry("nameless", {"own": Nameless(str)}, Nameless, error=UserError)
    install("nameless", bad=f"{THIS}:FAILING")
    named = f"bad = {THIS}:FAILING (package0 1.0): KeyError: 'x' (line "
    assert [answer for _, answer in registry.answers(lambda thing: thing.reads("x"))] == ["x"]
    assert named in registry.notes[0]
    assert registry.notes == tuple(note for note in plugin_notes() if "bad =" in note)
    answers = registry.answers(lambda thing: thing.reads("x"), is_last_raised=True)
    assert next(answers)[1] == "x"
    with pytest.raises(UserError, match="KeyError"):
        next(answers)
    with pytest.raises(UserError, match=r"^known to be wrong\.$"):  # its own sentence
        list(registry.usable["bad"].reads("known"))


def test_a_module_that_ends_the_program_is_left_out(readers, install, tmp_path):
    install("readers", script="module_that_exits:X")
    (tmp_path / "site-packages/module_that_exits.py").write_text("raise SystemExit(3)\n")
    assert len(readers.by_priority) == 2
    assert "cannot be used: SystemExit: 3." in readers.notes[0]


def test_hidden_objects_are_noted_when_the_name_is_used(things, install):
    install("things", own="module:another", late="module:late")
    assert things.notes == ()
    assert things.find("late") == "module:late"
    assert things.notes == ()
    assert things.find("own") == "os.path:join"
    assert things.notes == (
        "Entry point own = module:another (package0 1.0) cannot be used: "
        "the name 'own' is already in use.",
    )


def test_nothing_is_imported_for_names(readers, install):
    install("readers", absent="no_such_module:X")
    assert readers.names == ("any", "first", "absent")
    assert readers.notes == ()
