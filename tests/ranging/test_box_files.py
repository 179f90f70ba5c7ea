import numpy as np
import pytest

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.ranging.fitting.fit import compare_curves
from track_range.ranging.truth.box_files import read_box_csv

HEADER = "class,x1,y1,x2,y2,distance_m,fx\n"


@pytest.fixture
def file(tmp_path):
    def write(text):
        path = tmp_path / "boxes.csv"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_rows_by_hand(file):
    boxes, notes = read_box_csv(
        file(
            "Class,X1,y1,x2,y2,distance_m,fx,cx,fy,track,sequence\ncar,10,20,60,50,30,1000,320,500,7,n\nVan,0,0,9,9,5,900,1,2,8,m\n"
        )
    )
    assert boxes.class_name.tolist() == ["car", "van"]
    assert boxes.wh_over_f[0] == pytest.approx([0.05, 0.06])
    assert boxes.bearing[0] == pytest.approx(-0.285)
    assert [boxes.sequence_names[k] for k in boxes.sequence] == ["n", "m"]
    assert (boxes.distance_m.tolist(), notes) == ([30.0, 5.0], ())


def test_default_column_order(file):
    boxes, notes = read_box_csv(
        file("pedestrian,10,20,30,60,12.5,800\n\ncar,100,20,190,60,12.5,800\n")
    )
    assert boxes.class_name.tolist() == ["person", "car"]
    assert boxes.fxycxy_px[:, 0].tolist() == [800.0, 800.0]
    assert boxes.fxycxy_px[:, 2].tolist() == [100.0, 100.0]  # midway between 10 and 190
    assert len(notes) == 2
    assert "100 px" in notes[0]


def test_focal_length_as_an_argument(file):
    boxes, _ = read_box_csv(file("class,x1,y1,x2,y2,distance_m\ncar,1,2,3,4,5\n"), focal_px=700.0)
    assert boxes.wh_over_f[0] == pytest.approx([2 / 700, 2 / 700])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("class,x1,y1,x2,y2\ncar,1,2,3,4\n", "no column distance_m"),
        ("class,x1,y1,x2,y2,distance_m\ncar,1,2,3,4,5\n", "--focal-px"),
        (HEADER + "car,1,2,3,4,five,700\n", "line 2: .*for distance_m"),
        (HEADER + "car,1,2,3,4,5\n", "line 2: .*for fx"),
        (
            HEADER + "car,1,2,3,4,5,700\ncar,1,2,3,4,-5,700\n",
            "line 3: .*positive number .*for distance_m",
        ),
        (HEADER + "car,1,2,3,nan,5,700\n", "line 2: .*for y2"),
        (HEADER + "car,1,2,3,4,5,0\n", "positive number .*for fx"),
        (HEADER + "car,3,2,1,4,5,700\n", "line 2: .*x1 < x2"),
        (HEADER + "ufo,1,2,3,4,5,700\n", "line 2: .*'ufo'"),
        (HEADER, "row"),
    ],
)
def test_invalid_files(file, text, message):
    with pytest.raises(LabelFileError, match=message):
        read_box_csv(file(text))


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(LabelFileError, match=r"none\.csv: no such file"):
        read_box_csv(tmp_path / "none.csv")
    (tmp_path / "x.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(LabelFileError, match=r"x\.csv: .*UTF-8"):
        read_box_csv(tmp_path / "x.csv")


def test_table_three_by_hand(file):
    """Objects of one size, twice as wide as high: 1 / d is linear in h, so the inverse curve is
    exact."""
    rng = np.random.default_rng(0)
    rows = []
    for k, distance_m in enumerate(rng.uniform(10, 60, 200)):
        height_px = 700 * 1.5 / distance_m
        rows.append(
            f"car,{300 - height_px},100,{300 + height_px},{100 + height_px},{distance_m},700,700,300,100,{k},{k % 4}"
        )
    boxes, _ = read_box_csv(file("\n".join(rows)))
    fits = {fit.curve: fit for fit in compare_curves(boxes, "car")}
    exact, paper = fits["inverse-height"], fits["diagonal-3"]
    assert exact.n == 200
    assert exact.residual_m2 == pytest.approx(0.0, abs=1e-6)
    assert exact.at_m[0] == pytest.approx(20.0, rel=0.05)
    assert np.isnan(exact.at_m[4])  # there are no boxes at 90 m
    predicted = paper.predict(boxes.wh_over_f, boxes.bearing)
    assert paper.residual_m2 == pytest.approx(((predicted - boxes.distance_m) ** 2).sum())
    assert paper.fitted_error_pct == pytest.approx(
        100 * np.abs(predicted / boxes.distance_m - 1).mean()
    )
    assert 1.0 < paper.fitted_error_pct < paper.other_drives_error_pct < 30.0
    one = boxes.select(boxes.sequence == 0)
    assert np.isnan(compare_curves(one, "car")[0].other_drives_error_pct)
