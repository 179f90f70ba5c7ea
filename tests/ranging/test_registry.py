"""Registry of ranging methods: order, validation of descriptions, entry points of other
packages."""

from dataclasses import replace

import pytest

from tests.toys.registrations import registered_method
from track_range.ranging import registry
from track_range.ranging.methods.method import (
    ErrorSource,
    MethodContext,
    MethodError,
    RangingMethod,
)
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

CAMERA = PinholeCamera(700.0, 700.0, 599.5, 179.5, 1200, 360)

RADAR = RangingMethod(
    name="radar",
    title="radar",
    letter="R",
    colour="#123456",
    create=lambda context: None,
    error_sources=(ErrorSource("own", independent=1.0),),
)


def names(listed):
    return [method.name for method in listed]


def correlation(method, other):
    """Correlation of the independent errors of two methods."""
    parts = [
        {s.name: s.independent / m.noise_share**2 for s in m.error_sources if s.name != "own"}
        for m in (method, other)
    ]
    return sum((parts[0][name] * parts[1].get(name, 0.0)) ** 0.5 for name in parts[0])


def test_built_in_methods_in_order_with_their_noise():
    listed = registry.methods()[:5]
    assert names(listed) == ["mono", "ground", "lane", "stereo", "sgbm"]
    assert [method.noise_share for method in listed] == pytest.approx(
        [0.6, 0.742, 0.775, 0.3, 0.3], abs=1e-3
    )
    mono, ground, lane, stereo, _ = listed
    pairs = ((mono, ground), (mono, lane), (ground, lane), (mono, stereo))
    assert [correlation(*pair) for pair in pairs] == pytest.approx(
        [0.456, 0.345, 0.550, 0.0], abs=1e-3
    )


def test_built_in_methods_have_different_letters():
    letters = [method.letter for method in registry.methods()]
    assert len(set(letters)) == len(letters)


def test_registered_is_limited_to_the_block():
    with registered_method(RADAR):
        assert names(registry.methods())[-1] == "radar"
        with pytest.raises(MethodError, match="radar"):
            registry.register(RADAR)
        with pytest.raises(MethodError, match="letter"):
            registry.register(replace(RADAR, name="sonar"))
    assert "radar" not in names(registry.methods())


@pytest.mark.parametrize("change", [{"fallback_for": "monoo"}, {"reads": ("mono", "monoo")}])
def test_unknown_names_of_methods_are_refused(change):
    with pytest.raises(MethodError, match=r"'radar': .*mono, ground, lane, .*'monoo'"):
        registry.register(replace(RADAR, **change))
    with registered_method(replace(RADAR, fallback_for="stereo", reads=("mono",))):
        assert registry.origins() == {"radar": "tests.ranging.test_registry:<lambda>"}


def test_create_that_returns_no_ranger():
    with pytest.raises(MethodError, match=r"'radar': .*create\(\).*object"):
        registry.create_rangers(
            MethodContext(camera=CAMERA), [replace(RADAR, create=lambda context: object())]
        )


def test_measuring_order_follows_reads():
    first, second = replace(RADAR, name="a", reads=("b", "absent")), replace(RADAR, name="b")
    assert names(registry.in_measuring_order([first, second])) == ["b", "a"]
    with pytest.raises(MethodError, match="cycle"):
        registry.in_measuring_order([first, replace(second, reads=("a",))])
    order = names(registry.in_measuring_order(registry.methods()))
    assert order.index("lane") > order.index("stereo")


def test_rangers_are_created_if_their_needs_are_met():
    assert list(registry.create_rangers(MethodContext(camera=CAMERA))) == [
        "mono",
        "ground",
        "expansion",
    ]
    rig = StereoRig.rectified(CAMERA, 0.5)
    assert list(registry.create_rangers(MethodContext(camera=CAMERA, rig=rig))) == [
        "mono",
        "ground",
        "stereo",
        "expansion",
    ]
    everything = MethodContext(
        camera=CAMERA, rig=rig, has_lane_lines=True, has_dense_disparity=True
    )
    rangers = registry.create_rangers(everything)
    assert list(rangers) == ["mono", "ground", "stereo", "lane", "sgbm", "expansion"]
    for ranger in rangers.values():
        ranger.close()


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"name": "Radar"}, "lower-case"),
        ({"name": "radar_kf"}, "_kf"),
        ({"name": "fused"}, "fused"),
        ({"letter": "RD"}, "letter"),
        ({"colour": "red"}, "#rrggbb"),
        ({"reads": ("radar",)}, "reads"),
        ({"reads": "mono"}, "reads"),
        ({"reads": (1,)}, "reads"),
        ({"needs": frozenset({"radar"})}, "needs"),
        ({"needs": "rig"}, "needs"),
        ({"needs": None}, "needs"),
        ({"error_sources": (ErrorSource("weather", independent=1.0),)}, "contact_point"),
        ({"error_sources": (ErrorSource("own", independent=0.5),)}, "0.5000"),
        ({"error_sources": (ErrorSource("own", independent=1.5, systematic=-0.5),)}, "sum"),
        ({"error_sources": ()}, "sum"),
    ],
)
def test_invalid_descriptions(change, word):
    with pytest.raises(MethodError, match=word):
        replace(RADAR, **change)


def test_needs_and_reads_accept_any_collection():
    method = replace(RADAR, needs=["rig", "image"], reads=["mono"])
    assert method.needs == frozenset({"rig", "image"})
    assert method.reads == ("mono",)
    assert "radar" not in registry.create_rangers(MethodContext(camera=CAMERA), [method])


def test_entry_points(install, monkeypatch, tmp_path):
    (tmp_path / "radar_package.py").write_text(
        "from dataclasses import replace\n"
        "from track_range.ranging.methods.size_regression import MONO\n"
        "RADAR = replace(MONO, name='radar', letter='R')\n"
        "WORD = 'radar'\n"
        "LATER = replace(MONO, name='sonar', letter='V', fallback_for='twice')\n"
        "TYPO = replace(MONO, name='lidar', letter='I', fallback_for='radio')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    targets = {
        "absent": "radar_package:ABSENT",
        "good": "radar_package:RADAR",
        "other": "radar_package:WORD",
        "unknown": "no_such_package_of_radars:RADAR",
        "twice": "radar_package:RADAR",
        "later": "radar_package:LATER",
        "typo": "radar_package:TYPO",
    }
    install("track_range.ranging_methods", **targets)
    n_built_in = len(registry.METHODS.built_in)
    assert names(registry.methods())[n_built_in:] == ["radar", "sonar"]
    assert registry.origins()["radar"] == "radar_package:RADAR (package0 1.0)"
    notes = registry.METHODS.notes
    assert [note.split()[2] for note in notes] == ["absent", "other", "twice", "typo", "unknown"]
    assert all("\n" not in note for note in notes)


def test_methods_by_name_and_by_object():
    assert registry.method_of("stereo").letter == "S"
    with registry.METHODS.restored():
        found = registry.method_of("tests.ranging.test_registry:RADAR")
        assert found.name == "radar"
        assert registry.method_of("tests.ranging.test_registry:RADAR") is found
        assert registry.method_of("radar") is found
        assert names(registry.methods())[-1] == "radar"
    with pytest.raises(MethodError, match=r"'radar': expected mono, .*package\.module:OBJECT"):
        registry.method_of("radar")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("tests.ranging.test_registry:CAMERA", "PinholeCamera"),
        ("tests.ranging.test_registry:NOTHING", "NOTHING"),
        ("no_such_module:METHOD", "no_such_module"),
    ],
)
def test_objects_that_are_no_methods(text, word):
    with pytest.raises(MethodError, match=f"{text}: .*{word}"):
        registry.method_of(text)


def test_another_method_with_the_name_of_a_known_one_is_refused():
    with (
        registered_method(replace(RADAR, title="other")),
        pytest.raises(MethodError, match="radar"),
    ):
        registry.method_of("tests.ranging.test_registry:RADAR")
