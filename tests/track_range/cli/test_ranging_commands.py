"""`evaluate ranges` and `fit` on the command line, on synthetic drives and on KITTI."""

import json

import numpy as np
import pytest

from tests.support.recordings.label_rows import F_PX, approaching_rows, label_row as row
from track_range.ranging.fitting.fit import MODEL_NAMES
from track_range.ranging.size_models.curve import load_curves


@pytest.fixture
def folders(tmp_path):
    def write(**drives):
        for place in ("labels", "calib"):
            (tmp_path / place).mkdir(exist_ok=True)
        for name, rows in drives.items():
            (tmp_path / "labels" / f"{name}.txt").write_text("\n".join(rows) + "\n")
            (tmp_path / "calib" / f"{name}.txt").write_text(
                f"P2: {F_PX} 0 600 0 0 {F_PX} 180 0 0 0 1 0\n"
            )
        return ("--labels", tmp_path / "labels", "--calib", tmp_path / "calib")

    return write


def test_output_as_table_json_and_markdown(cli, folders, tmp_path):
    given = folders(a=approaching_rows(0), b=approaching_rows(1), c=approaching_rows(2))
    files = ("--json", tmp_path / "f.json", "--table", tmp_path / "f.md")
    status, out, err = cli(
        "evaluate", "ranges", *given, "--cross-validate", "--region", "europe", *files
    )
    assert (status, err) == (0, "")
    figures = json.loads((tmp_path / "f.json").read_text())
    assert set(figures["methods"]) >= {
        "diagonal-3",
        "diagonal-4",
        "diagonal-5",
        "inverse-height",
        "log-linear",
        "mono",
    }
    assert {"ground", "mono+ground"} <= set(figures["methods"])
    for name, classes in figures["methods"].items():
        assert set(classes) == {"car", "person"}, name
        assert {
            "n",
            "bias_pct",
            "within_1_sigma",
            "within_2_sigma",
            "rear_view_pct",
            "far_pct",
        } <= set(classes["car"])
    mono, plain = figures["methods"]["mono"]["car"], figures["methods"]["diagonal-3"]["car"]
    assert mono["mean_relative_error_pct"] < 1.0 < plain["mean_relative_error_pct"] < 60.0
    assert mono["bands"][0]["to_m"] == 10.0
    assert "closing_median_error_mps" not in mono
    assert list(mono["by_drive"]) == ["a", "b", "c"]
    errors = ("bias_pct", "within_1_sigma", "within_2_sigma")
    keys = {"n", "n_tracks", *errors, *(f"{name}_ci95" for name in errors)}
    assert set(mono["by_drive"]["a"]) == keys
    assert sum(drive["n"] for drive in mono["by_drive"].values()) == mono["n"]
    assert mono["worst_drive"] in mono["by_drive"]
    table = (tmp_path / "f.md").read_text()
    assert "| mono |" in table
    assert f"car by drive, worst: mono {mono['worst_drive']} (" in table
    assert "| drive | tracks | mono n | mono bias % |" in table
    assert "log-linear n" not in table  # without a sigma
    assert "mono" in out
    assert "3 folds over 3 sequences" in " ".join(out.split())


def car_by(cli, file, method, *arguments):
    assert (
        cli(
            "evaluate", "ranges", *arguments, "--method", method, "--cross-validate", "--json", file
        )[0]
        == 0
    )
    return json.loads(file.read_text())["methods"][method]["car"]


def test_noise_is_seeded(cli, folders, tmp_path):
    given = folders(a=approaching_rows(0), b=approaching_rows(1), c=approaching_rows(2))
    exact, noisy, again, other = (
        car_by(cli, tmp_path / "f.json", "log-linear", *given, *options)["mean_relative_error_pct"]
        for options in ((), ("--noise-px", 2), ("--noise-px", 2), ("--noise-px", 2, "--seed", 1))
    )
    assert noisy == again != other
    assert exact < 0.2 * noisy


@pytest.mark.slow
def test_filters_smooth_and_give_closing_speeds(cli, folders, tmp_path):
    given = (
        *folders(a=approaching_rows(0), b=approaching_rows(1), c=approaching_rows(2)),
        "--noise-px",
        2,
    )
    none, paper, default = (
        car_by(cli, tmp_path / "f.json", "mono", *given, "--filter", name)
        for name in ("none", "paper", "default")
    )
    assert default["mean_relative_error_pct"] < 0.75 * none["mean_relative_error_pct"]
    assert paper["closing_median_error_mps"] > default["closing_median_error_mps"] > 0
    assert none["within_2_sigma"] > 0.85


def test_fit_and_test_on_the_same_drive(cli, folders, tmp_path):
    """People are 5 % taller in one drive, which causes errors only if the curves are fitted to
    others."""
    tall = [row(k, 0, "Pedestrian", 60 - 0.3 * k, scale=1.1) for k in range(160)]
    usual = [[row(k, 0, "Pedestrian", d_m - 0.3 * k) for k in range(160)] for d_m in (58.0, 62.0)]
    given = (
        "evaluate",
        "ranges",
        *folders(a=tall, b=usual[0], c=usual[1]),
        "--method",
        "log-linear",
        "--json",
    )
    error = {}
    for option in ("--same-drive", "--cross-validate"):
        status, out, _ = cli(*given, tmp_path / "f.json", option)
        assert status == 0
        error[option] = json.loads((tmp_path / "f.json").read_text())["methods"]["log-linear"][
            "person"
        ]
        assert ("the same drive" in " ".join(out.split())) == (option == "--same-drive")
    assert error["--same-drive"]["mean_relative_error_pct"] < 0.1
    assert 3.0 < error["--cross-validate"]["mean_relative_error_pct"] < 12.0
    assert error["--same-drive"]["rear_view_far_pct"] < 0.1


def test_packaged_curves_and_chosen_methods(cli, folders, tmp_path):
    given = folders(a=approaching_rows(0))
    status, out, _ = cli(
        "evaluate", "ranges", *given, "--method", "ground,log-linear", "--json", tmp_path / "f.json"
    )
    assert status == 0
    figures = json.loads((tmp_path / "f.json").read_text())
    assert list(figures["methods"]) == ["ground", "log-linear"]
    assert "by drive" not in out  # a single one
    assert "the only sequence" in " ".join(out.split())
    assert "packaged" in out


@pytest.mark.parametrize(
    ("options", "status", "message"),
    [
        (("--method", "mono,radar"), 2, "--methods radar: "),
        (("--boxes", "other"), 2, "--boxes other: "),
        (("--boxes", "rrc:nowhere"), 1, "DIR/Car"),
        (("--cross-validate", "--curves", "c.json"), 2, "--curves: "),
        (("--same-drive", "--cross-validate"), 2, "--same-drive"),
        (("--curves", "none.json"), 1, "none.json: no such file"),
        (("--json", "no/such/folder/f.json"), 1, "cannot be written"),
    ],
)
def test_invalid_usage_of_evaluate_ranges(cli, folders, options, status, message):
    actual_status, _, err = cli("evaluate", "ranges", *folders(a=approaching_rows(0)), *options)
    assert (actual_status, message in err) == (status, True), err


@pytest.mark.slow
def test_fit_compares_draws_and_writes(cli, folders, tmp_path):
    given = folders(
        a=approaching_rows(0), b=approaching_rows(1), c=approaching_rows(2, n_frames=20)
    )
    outputs = (
        "--compare",
        "--picture",
        tmp_path / "p.png",
        "--out",
        tmp_path / "c.json",
        "--leave-out",
        "c",
    )
    status, out, err = cli("fit", *given, *outputs, "--source", "made drives")
    assert (status, err) == (0, "")
    assert out.count("inverse-height") == 2  # of cars and of people
    assert "car: 240 boxes" in out
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    assert "made drives, sequences a, b" in (tmp_path / "c.json").read_text()
    load_curves(tmp_path / "c.json")
    again = (
        "evaluate",
        "ranges",
        *given,
        "--method",
        "mono",
        "--curves",
        tmp_path / "c.json",
        "--json",
    )
    assert cli(*again, tmp_path / "f.json")[0] == 0
    car = json.loads((tmp_path / "f.json").read_text())["methods"]["mono"]["car"]
    assert car["mean_relative_error_pct"] < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("curve", MODEL_NAMES)
def test_fitted_curves_are_usable_in_a_run(cli, folders, tmp_path, curve):
    given = folders(a=approaching_rows(0), b=approaching_rows(1))
    assert cli("fit", *given, "--curve", curve, "--out", tmp_path / "c.json")[0] == 0
    assert (
        cli(
            "evaluate",
            "ranges",
            *given,
            "--method",
            "mono",
            "--curves",
            tmp_path / "c.json",
            "--json",
            tmp_path / "f",
        )[0]
        == 0
    )
    car = json.loads((tmp_path / "f").read_text())["methods"]["mono"]["car"]
    assert car["coverage"] == 1.0
    assert car["mean_relative_error_pct"] < {
        "cuboids": 4.0,
        "log-linear": 1.5,
        "inverse-height": 1.5,
    }.get(curve, 35.0)
    assert car["within_2_sigma"] > 0.7


def test_curve_file_of_another_version(cli, folders, tmp_path):
    given = folders(a=approaching_rows(0), b=approaching_rows(1))
    assert cli("fit", *given, "--out", tmp_path / "c.json")[0] == 0
    old = json.loads((tmp_path / "c.json").read_text()) | {"track_range_size_curves": 1}
    (tmp_path / "c.json").write_text(json.dumps(old))
    status, _, err = cli(
        "evaluate", "ranges", *given, "--method", "mono", "--curves", tmp_path / "c.json"
    )
    assert (status, "c.json: " in err, "version" in err) == (1, True, True), err


def test_labels_without_3d_boxes(cli, folders, tmp_path):
    flat = [f"{k} 0 Car 0 0 0 10 10 {60 + k} 40 -1 -1 -1 -1000 -1000 -1000 -10" for k in range(150)]
    status, _, err = cli("fit", *folders(a=flat), "--out", tmp_path / "c.json")
    assert (status, "3-D box" in err) == (1, True), err


def test_fit_on_a_csv(cli, tmp_path):
    rng = np.random.default_rng(0)
    lines = ["class,x1,y1,x2,y2,distance_m"]
    for distance_m in rng.uniform(8, 60, 150):
        height_px = 900 * 1.5 / distance_m
        lines.append(f"car,100,100,{100 + 1.1 * height_px},{100 + height_px},{distance_m}")
    (tmp_path / "b.csv").write_text("\n".join(lines))
    given = ("fit", "--csv", tmp_path / "b.csv", "--out", tmp_path / "c.json")
    status, _, err = cli(*given)
    assert (status, "b.csv: " in err, "--focal-px" in err) == (1, True, True)
    status, out, _ = cli(*given, "--focal-px", 900)
    assert status == 0
    assert "one sequence" in out
    assert "b.csv" in (tmp_path / "c.json").read_text()


@pytest.mark.parametrize(
    ("kinds", "n_frames", "message"),
    [
        (("Car",), 10, "car (10 boxes"),
        (("Car", "Pedestrian"), 60, "person (60 boxes"),
    ],
)
def test_too_few_boxes(cli, folders, tmp_path, kinds, n_frames, message):
    given = folders(a=approaching_rows(0, kinds, n_frames))
    status, _, err = cli("fit", *given, "--out", tmp_path / "c.json")
    assert (status, message in err) == (1, True), err
    assert not (tmp_path / "c.json").exists()


def test_only_classes_with_enough_boxes_are_fitted(cli, folders, tmp_path):
    rows = [row(k, k // 50, "Car", 10.0 + 0.3 * k) for k in range(150)]
    rows += [row(k, 3, "Van", 20.0, x_m=6) for k in range(150)]
    status, out, _ = cli("fit", *folders(a=rows), "--out", tmp_path / "c.json")
    assert status == 0
    assert "van (all boxes of the same size" in " ".join(out.split())
    same = [row(k, 0, "Car", 20.0) for k in range(150)]
    status, _, err = cli("fit", *folders(a=same), "--out", tmp_path / "d.json")
    assert (status, "car (all boxes of the same size" in err) == (1, True), err


@pytest.mark.parametrize(
    ("options", "status", "message"),
    [
        (("--compare",), 2, "--csv"),
        (("--labels", "x", "--csv", "y", "--compare"), 2, "either"),
        (("--labels", "x", "--compare"), 2, "--calib"),
        (("--csv", "x"), 2, "--out"),
        (("--csv", "x", "--compare", "--curve", "spline"), 2, "--curve spline: "),
        (("--csv", "x", "--out", "c.json", "--curve", "cuboids"), 2, "3-D boxes"),
        (("--csv", "none.csv", "--compare"), 1, "none.csv: no such file"),
    ],
)
def test_invalid_usage_of_fit(cli, options, status, message):
    actual_status, _, err = cli("fit", *options)
    assert (actual_status, message in err) == (status, True), err


def test_kitti_figures_are_unchanged(cli, shared_data, tmp_path):
    """Errors of the curves of one measure on all drives, with lower and upper bounds."""
    place = shared_data / "kitti_labels"
    given = (
        "--labels",
        place / "label_02",
        "--calib",
        place / "calib",
        "--json",
        tmp_path / "f.json",
    )
    given = (*given, "--region", "europe")
    assert (
        cli("evaluate", "ranges", *given, "--method", "log-linear,inverse-height,height-5")[0] == 0
    )
    methods = json.loads((tmp_path / "f.json").read_text())["methods"]
    mean = {
        name: {kind: row["mean_relative_error_pct"] for kind, row in rows.items()}
        for name, rows in methods.items()
    }
    assert mean["log-linear"]["car"] == pytest.approx(5.36, abs=0.02)
    assert mean["inverse-height"]["bicycle"] == pytest.approx(3.27, abs=0.02)
    assert mean["height-5"]["person"] == pytest.approx(5.97, abs=0.02)
    assert methods["log-linear"]["car"]["n"] == 10670


def test_methods_on_four_drives(cli, shared_data, tmp_path):
    for kind in ("label_02", "calib"):
        (tmp_path / kind).mkdir()
        for name in ("0000", "0002", "0013", "0018"):
            (tmp_path / kind / f"{name}.txt").symlink_to(
                shared_data / "kitti_labels" / kind / f"{name}.txt"
            )
    given = (
        "--labels",
        tmp_path / "label_02",
        "--calib",
        tmp_path / "calib",
        "--json",
        tmp_path / "f.json",
    )
    assert (
        cli("evaluate", "ranges", *given, "--method", "log-linear,mono,ground,mono+ground")[0] == 0
    )
    methods = json.loads((tmp_path / "f.json").read_text())["methods"]
    assert 2.0 < methods["mono"]["car"]["mean_relative_error_pct"] < 7.0
    assert 4.0 < methods["ground"]["car"]["mean_relative_error_pct"] < 20.0
    assert 0.55 < methods["ground"]["car"]["within_1_sigma"] < 0.98
    assert 2.0 < methods["mono+ground"]["person"]["mean_relative_error_pct"] < 10.0
