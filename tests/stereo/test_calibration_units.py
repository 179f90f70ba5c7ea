"""Units of lengths, and parts of cameras, from the quantities of a calibration."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.dialects import DIALECTS
from track_range.stereo.rig_formats.values.aliases import QUANTITIES, meaning
from track_range.stereo.rig_formats.values.cameras import distortion_of, of_scalars, stated_size
from track_range.stereo.rig_formats.values.dialect import Dialect, Unit
from track_range.stereo.rig_formats.values.draft import RigDraft, draft_of
from track_range.stereo.rig_formats.values.units import unit_of

CITYSCAPES = next(dialect for dialect in DIALECTS if dialect.name == "cityscapes")


def draft(content: dict[str, Any]) -> RigDraft:
    return draft_of(content, Path("a.yml"))


@pytest.mark.parametrize(
    ("content", "length", "metres", "reason"),
    [
        ({"T": [-120, 0, 0]}, 120.0, 0.001, "to be in millimetres"),
        ({"T": [-12, 0, 0]}, 12.0, 0.01, "in millimetres it would be 0.012 m"),
        # squares of 24 mm: T is in millimetres, too
        ({"T": [-12, 0, 0], "square_size": 24}, 12.0, 0.001, "to be in millimetres"),
        ({"T": [-0.12, 0, 0]}, 0.12, 1.0, "square size was given in metres"),
        ({"T": [-2, 0, 0]}, 2.0, 1.0, "a wide baseline"),
        ({"T": [-12, 0, 0], "units": "inches"}, 12.0, 0.0254, "inches as the file states"),
        ({"T": [-12, 0, 0], "units": "inch"}, 12.0, 0.0254, "inches as the file states"),
        ({"T": [-12, 0, 0], "units": "in"}, 12.0, 0.0254, "inches as the file states"),
        # the unit in a name is that of its value
        ({"T_mm": [-4, 0, 0], "units": "m"}, 4.0, 0.001, "millimetres by the name of T"),
        ({"T": [-0.12, 0, 0], "units": "m", "B_mm": 120}, 0.12, 1.0, "as the file states"),
        ({"T_mm": [-120, 0, 0]}, 0.12, 1.0, "metres by the name of T"),  # of projections
        # the pose of one camera has its own unit
        ({"T": [-1.2, 0, 0], "cam1": {"T_mm": [9, 0, 0]}}, 1.2, 1.0, "assuming that the square"),
        ({"T": [-12, 0, 0], "unit": "Metres"}, 12.0, 1.0, "metres as the file states"),
        ({"translation_mm": [-12, 0, 0]}, 12.0, 0.001, "millimetres by the name of T"),
        ({"T_mm": [-12, 0, 0]}, 12.0, 0.001, "millimetres by the name of T"),
        ({"t_cm": [-2, 0, 0]}, 2.0, 0.01, "centimetres by the name of T"),
        ({"T_m": [-4, 0, 0]}, 4.0, 1.0, "metres by the name of T"),
        ({"cam2": {"T_mm": [-12, 0, 0]}}, 12.0, 0.001, "millimetres by the name of T"),
        ({"B_mm": 120}, 120.0, 0.001, "millimetres by the name of baseline"),
        # 12 units are 12.1 cm, so the unit is the centimetre
        ({"T": [-12, 0, 0], "baseline_mm": 121}, 12.0, 0.01, "centimetres by the name of baseline"),
    ],
)
def test_unit_of_lengths(content, length, metres, reason):
    given = draft(content)
    of_pair = given.get(None, "T")
    key = "T" if of_pair is None else of_pair.key
    unit = unit_of(given, length, key if length >= 1 else "P2")
    assert (unit.metres, unit.is_doubtful) == (metres, False)
    assert reason in unit.reason


@pytest.mark.parametrize(
    ("content", "length", "keys"),
    [
        ({"T_m": [-0.5, 0, 0], "baseline_mm": 120}, 0.5, "T_m and baseline_mm"),
        ({"T": [-120, 0, 0], "baseline_m": 0.5}, 120.0, "T and baseline_m"),
        ({"T": [-4, 0, 0], "units": "m", "baseline_mm": 4}, 4.0, "T and baseline_mm"),
        (
            {"cam1": {"T_cm": [1, 0, 0]}, "cam2": {"T_mm": [2, 0, 0]}},
            1.0,
            "cam1.T_cm and cam2.T_mm",
        ),
    ],
)
def test_a_length_that_contradicts_one_with_its_unit(content, length, keys):
    given = draft(content)
    of_pair = given.get(None, "T")
    key = "T" if of_pair is None else of_pair.key
    with pytest.raises(RigError, match=keys):
        unit_of(given, length, key)


def test_the_unit_of_a_dialect_gives_way_to_that_of_a_name():
    orb_slam = next(dialect for dialect in DIALECTS if dialect.name == "orb-slam")
    given = draft_of({"Stereo": {"baseline_mm": 4}}, Path("a.yml"), orb_slam)
    assert unit_of(given, 4.0, "Stereo.baseline_mm").metres == 0.001


def test_a_length_by_its_size_is_named():
    assert "the length of baseline, 120," in unit_of(draft({}), 120.0, "baseline").reason


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize(
    "content",
    [
        {"T_mm": [-120, 0, 0], "T_m": [-0.5, 0, 0]},
        {"T_mm": [-500, 0, 0], "T": [-0.12, 0, 0]},
        {"T": [-120, 0, 0], "translation": [-5, 0, 0], "T_m": [-0.12, 0, 0]},
        {"baseline_mm": 120, "baseline_m": 0.5},
        {"K1": [700, 0, 320, 0, 700, 240, 0, 0, 1], "camera_matrix_1": [800, 800, 320, 240]},
    ],
)
def test_values_of_one_place_that_contradict_one_another(content, reverse):
    keys = list(content)
    content = {key: content[key] for key in (keys[::-1] if reverse else keys)}
    with pytest.raises(
        RigError, match=r"expected \S+ and \S+ to agree.*remove the wrong one"
    ) as error:
        draft(content)
    assert sum(key in str(error.value).split() for key in keys) == 2


@pytest.mark.parametrize("reverse", [False, True])
def test_values_of_one_place_that_agree(reverse):
    content = {"T": [-12, 0, 0], "T_mm": [-120, 0, 0], "K1": [700, 700, 320, 240]}
    content |= {"M1": [700.1, 0, 0, 0, 700, 0, 320, 240, 1], "raw": {"K1": [900, 900, 320, 240]}}
    keys = list(content)[:4]
    given = draft({key: content[key] for key in (*(keys[::-1] if reverse else keys), "raw")})
    assert given.stated[None, "T"].key == "T_mm"
    assert given.stated[1, "K"].key == ("M1" if reverse else "K1")


def test_drafts_that_contradict_one_another():
    assert (draft({"T": [-12, 0, 0]}) | draft({"T_cm": [-12, 0, 0]})).stated[
        None, "T"
    ].key == "T_cm"
    with pytest.raises(RigError, match="T_m and T"):
        draft({"T": [-12, 0, 0]}) | draft({"T_m": [-0.5, 0, 0]})


def test_a_length_between_metres_and_centimetres_is_in_doubt():
    given = draft({"T": [-4, 0, 0]})
    assert unit_of(given, 4.0).is_doubtful
    usual = Unit(0.001, "as usual")
    dialect = Dialect(name="a", title="a", pattern=re.compile(""), usual_unit=usual)
    assert unit_of(replace(given, dialect=dialect), 4.0) == usual


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ({"D": [0.1, 0.2]}, [0.1, 0.2]),
        ({"RadialDistortion": [0.1, 0.2, 0.3]}, [0.1, 0.2, 0, 0, 0.3]),
        ({"k1": 0.1, "k2": 0.2, "p1": 0.3, "p2": 0.4}, [0.1, 0.2, 0.3, 0.4]),
        ({"k1": 0.1, "k3": 0.2}, [0.1, 0, 0, 0, 0.2]),
        ({"k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4}, [0.1, 0.2, 0.3, 0.4]),  # Kannala-Brandt
        ({"k1": 0.1, "p1": 0.2, "k6": 0.3}, [0.1, 0, 0.2, 0, 0, 0, 0, 0.3]),
        ({"K": list(range(9))}, None),
    ],
)
def test_distortion_in_the_order_of_opencv(content, expected):
    distortion = distortion_of(draft(content), None)
    assert (None if distortion is None else distortion.tolist()) == expected


def test_camera_matrix_of_scalars():
    content = {"focal_length": 700, "cx": 320, "cy": 180}
    assert of_scalars(draft(content), None).tolist() == [700, 700, 320, 180]
    assert of_scalars(draft({"focal_length": 700, "cx": 320}), None) is None


@pytest.mark.parametrize("size", [[1280, 720], [720, 1280]])  # or rows and columns
def test_size_in_the_order_of_the_principal_point(size):
    given = draft({"image_size": size})
    assert stated_size(given, None, np.array([641.0, 355.0])).tolist() == [1280, 720]


def test_every_value_knows_its_file_and_key():
    given = draft({"left": {"K": list(range(9))}, "T_mm": [-120, 0, 0]})
    assert (given.stated["left", "K"].path, given.stated["left", "K"].key) == (
        Path("a.yml"),
        "left.K",
    )
    assert given.stated[None, "T"].meaning.metres == 0.001
    size = draft_of({}, Path("a.yml"), CITYSCAPES).stated[None, "size"]
    assert size.is_assumed
    assert size.value.tolist() == [2048, 1024]


@pytest.mark.parametrize(
    ("key", "n_values", "side", "quantity", "metres"),
    [
        ("K1", 9, 1, "K", None),
        ("left_camera_matrix", 9, "left", "K", None),
        ("distR", 5, "right", "D", None),
        ("R_left", 9, "left", "rect", None),
        ("k1", 1, None, "k1", None),  # a coefficient
        ("k1", 9, 1, "K", None),  # a matrix
        ("left_T_mm", 3, "left", "T", 0.001),
        ("baselineCm", 1, None, "baseline", 0.01),
        ("square_size_m", 1, None, "square", 1.0),
    ],
)
def test_meaning_of_a_key(key, n_values, side, quantity, metres):
    found = meaning((key,), n_values)
    assert found is not None
    assert (found.side, found.quantity.name, found.metres) == (side, quantity, metres)


@pytest.mark.parametrize("key", ["E", "retval", "focal_length_mm", "image_width_mm", "K_m"])
def test_keys_of_no_quantity(key):
    """Only lengths have units: a focal length in millimetres is none in pixels."""
    assert meaning((key,), 1) is None


def test_no_alias_of_two_quantities():
    aliases = [alias for row in QUANTITIES for alias in row.aliases.split()]
    assert len(aliases) == len(set(aliases))
