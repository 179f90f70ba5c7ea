"""align.yaml: written files are read back, and wrong files are error in one sentence."""

from __future__ import annotations

from pathlib import Path

import pytest

from track_range.stereo.alignment.file import load_alignment, save_alignment
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.rig import RigError


def test_round_trip(tmp_path: Path) -> None:
    alignment = Alignment(
        offset_px=0.45,
        curvature_px=1.5,
        row_offset_px=-0.2,
        residual_px=0.21,
        offset_sigma_px=0.05,
        curvature_sigma_px=0.1,
        source="drive: ä, 16 frames",
    )
    save_alignment(alignment, tmp_path / "align.yaml")
    assert load_alignment(tmp_path / "align.yaml") == alignment
    assert [path.name for path in tmp_path.iterdir()] == ["align.yaml"]


def test_short_file(tmp_path: Path) -> None:
    file = tmp_path / "align.yaml"
    file.write_text("track_range_align: 1\noffset_px: 1\n")
    assert load_alignment(file) == Alignment(offset_px=1.0, source=str(file))


@pytest.mark.parametrize(
    ("text", "key_word"),
    [
        ("a: [", "YAML"),
        ("- 1", "keys"),
        ("track_range_rig: 1", "track_range_align"),
        ("track_range_align: 2\noffset_px: 0", "track_range_align"),
        ("track_range_align: true\noffset_px: 0", "True"),
        ("track_range_align: 1", "offset_px"),
        ("track_range_align: 1\noffset_px: 0\nofset: 1", "ofset"),
        ("track_range_align: 1\noffset_px: half", "half"),
        ("track_range_align: 1\noffset_px: true", "True"),
        ("track_range_align: 1\noffset_px: .nan", "nan"),
        ("track_range_align: 1\noffset_px: 540", "540"),
        ("track_range_align: 1\noffset_px: 0\nresidual_px: -1", "residual_px"),
        ("track_range_align: 1\noffset_px: 0\nsource: 3", "source"),
    ],
)
def test_wrong_files(tmp_path: Path, text: str, key_word: str) -> None:
    file = tmp_path / "align.yaml"
    file.write_text(text)
    with pytest.raises(RigError) as error:
        load_alignment(file)
    assert key_word in str(error.value)
    assert str(error.value).startswith(str(file))


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"missing\.yaml"):
        load_alignment(tmp_path / "missing.yaml")
    with pytest.raises(RigError, match="folder"):
        load_alignment(tmp_path)
    (tmp_path / "video.mp4").write_bytes(b"\xff\xfe\x00" * 10)
    with pytest.raises(RigError, match=r"video\.mp4"):
        load_alignment(tmp_path / "video.mp4")
    (tmp_path / "large.yaml").write_bytes(b"#" * 200_000)
    with pytest.raises(RigError, match=r"large\.yaml"):
        load_alignment(tmp_path / "large.yaml")


def test_folder_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(RigError, match="cannot be written"):
        save_alignment(Alignment(), tmp_path / "no folder" / "align.yaml")
