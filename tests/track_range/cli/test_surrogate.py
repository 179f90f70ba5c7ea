"""`track-range surrogate`: the table of a run and of a fleet, and its exports."""

import csv
import math
import shutil

import numpy as np
import pytest
from pyarrow import parquet

from tests.support.results.frame_results import changed, result, writing
from track_range.foundation.files.output_files import OutputError
from track_range.ranging.warning.safety import SafetyMeasures
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import ObjectMotion
from track_range.results.surrogate import by_class, surrogate_rows

NAN = math.nan


def frame(index):
    """Track 3, a car that crosses at 12 m while the ego vehicle drives 1 m per frame; track 7 is a
    traffic light."""
    given = result(index)
    pair, motion = np.array, np.array([NAN, NAN])
    gap_m, ttc_s = 20.0 - index, 4.0 - 0.1 * index
    safety = SafetyMeasures(
        pair([gap_m, 9.0]), pair([ttc_s, NAN]), pair([gap_m / 10, NAN]), pair([3.0 + (index == 2), NAN]),
        pair([5.0, NAN]), pair([0.1 * index, 0.0]), pair([0.01 * index, 0.0]), pair([0.0, NAN]), pair([0.1, NAN]),
        np.array([index < 5, False]),
    )  # fmt: skip
    motion = ObjectMotion(
        motion,
        motion,
        motion,
        pair([12.0, NAN]),
        pair([-3.0 + index, NAN]),
        pair([3.0, NAN]),
        pair([0.9, NAN]),
    )
    pose = EgoPose(1.0 * index, 0.0, 0.0, np.zeros((3, 3)))
    time = type(given.frame)(index, index / 10, given.frame.left, None)
    closing_mps = pair([10.0, NAN])
    return changed(
        given,
        frame=time,
        safety=safety,
        motion=motion,
        ego_pose=pose,
        closing_mps=closing_mps,
        closing_sigma_mps=0.1 * closing_mps,
        ttc_s=pair([ttc_s + 0.15, NAN]),
        ttc_sigma_s=pair([0.1, NAN]),
    )


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    with writing(folder, ("csv", "parquet", "poses")) as rows:
        for index in range(20):
            rows.write(frame(index))
    return folder


def test_rows_by_hand(run):
    (car,) = surrogate_rows(run)  # no traffic light
    assert (car["clip"], car["track_id"], car["class"], car["state"]) == ("", 3, "car", "crossing")
    assert (car["min_gap_m"], car["min_gap_m_at_s"]) == pytest.approx((1.0, 1.9))
    assert (car["min_ttc_front_s"], car["max_drac_mps2"]) == pytest.approx((2.1, 3.19), abs=0.01)
    assert car["max_drac_mps2_at_s"] == pytest.approx(0.2)  # 4 of one frame does not count
    assert (car["tet_s"], car["tit_s2"]) == (pytest.approx(1.9), pytest.approx(0.19))
    assert car["lead_s"] == pytest.approx(0.5)
    # leaves the path of 2 x 1.8 m between 0.4 and 0.5 s; the front is at x = 12 m at 1.05 s
    assert car["pet_s"] == pytest.approx(1.05 - 0.45, abs=0.06)


def test_figures_by_class():
    row = {"class": "car", "tet_s": 1.0, "tit_s2": 0.5, "lead_s": 2.0, "pet_s": None}
    row |= {
        "min_gap_m": 3.0,
        "min_headway_s": None,
        "min_ttc_front_s": 2.0,
        "max_drac_mps2": 1.0,
        "max_mdrac_mps2": 2.0,
    }
    other = row | {"tet_s": 0.0, "min_gap_m": 2.0, "max_drac_mps2": 4.0, "pet_s": 1.5}
    cars, people = by_class([row, {**other, "class": "person"}, other])[::-1]
    assert (cars["n"], cars["n_exposed"], cars["min_gap_m"], cars["max_drac_mps2"]) == (
        2,
        1,
        2.0,
        4.0,
    )
    assert (cars["tet_s"], cars["lead_s"], cars["pet_s"], cars["min_headway_s"]) == (
        1.0,
        4.0,
        1.5,
        None,
    )
    assert (people["class"], people["n"]) == ("person", 1)


def test_table_and_exports(run, tmp_path, cli):
    status, printed, error = cli(
        "surrogate", run, "--csv", tmp_path / "a.csv", "--parquet", tmp_path / "a.parquet"
    )
    assert (status, error) == (0, "")
    assert "car 3" in printed
    with (tmp_path / "a.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["class"], row["lead_s"], row["clip"]) == ("car", "0.5", "")
    table = parquet.read_table(tmp_path / "a.parquet")
    assert table.column_names == list(row)
    assert table.column("min_gap_m").to_pylist() == pytest.approx([1.0])


def test_clips_of_a_fleet(run, tmp_path, cli):
    for clip in ("b", "a"):
        (tmp_path / f"fleet/tracks/clip={clip}").mkdir(parents=True)
        shutil.copy(run / "tracks.parquet", tmp_path / f"fleet/tracks/clip={clip}/tracks.parquet")
    (tmp_path / "fleet/runs/clip=b").mkdir(parents=True)
    shutil.copy(run / "poses.csv", tmp_path / "fleet/runs/clip=b/poses.csv")
    first, second = surrogate_rows(tmp_path / "fleet")
    assert (first["clip"], second["clip"]) == ("a", "b")
    assert first["pet_s"] is None  # without poses
    assert second["pet_s"] > 0
    assert "a car 3" in cli("surrogate", tmp_path / "fleet")[1]


def test_rows_without_measures_are_refused(tmp_path, run):
    header, *rows = (run / "tracks.csv").read_text().splitlines()
    place = header.split(",").index("gap_m")
    old = [",".join(line.split(",")[:place]) for line in (header, *rows)]
    (tmp_path / "tracks.csv").write_text("\n".join(old) + "\n")
    with pytest.raises(OutputError, match=r"gap_m.*repeat the run"):
        surrogate_rows(tmp_path)


def test_a_run_without_tracks(tmp_path, cli):
    with writing(tmp_path, ("csv",)):
        pass
    status, _, error = cli(
        "surrogate", tmp_path, "--csv", tmp_path / "a.csv", "--parquet", tmp_path / "a.parquet"
    )
    assert (status, error) == (0, "")
    assert (
        (tmp_path / "a.csv").read_text().replace('"', "").startswith("clip,track_id,class,state,")
    )
    assert parquet.read_table(tmp_path / "a.parquet").num_rows == 0
