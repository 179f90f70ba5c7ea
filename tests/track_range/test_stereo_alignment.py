"""Which correction a run takes, and what it says of it."""

import pytest

from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scene import make_scene
from track_range.stereo.alignment.file import save_alignment
from track_range.stereo.alignment.model import UNCORRECTED_SIGMA_PX, Alignment
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import RigError
from track_range.video.auto_alignment import FoundAlignment, find_alignment

RIG = kitti_like_rig(width_px=620, height_px=188)


def never():
    raise AssertionError("no look through the drive is needed")
    yield


def test_off_says_so_and_corrects_nothing():
    found = find_alignment("off", RIG, never())
    assert not found.is_applied
    assert (found.applied.offset_px, found.applied.residual_px) == (0.0, UNCORRECTED_SIGMA_PX)
    assert found.notes == ("Alignment: off, as asked; disparities are taken as they are, +- 0.50 px.",)


def test_a_file_is_applied_as_it_is(tmp_path):
    written = Alignment(offset_px=0.4, bow_px=1.2, offset_sigma_px=0.3, residual_px=0.2, source="my labels")
    save_alignment(written, tmp_path / "align.yaml")
    found = find_alignment(str(tmp_path / "align.yaml"), RIG, never())
    assert (found.is_applied, found.applied) == (True, written)
    assert "(from my labels); corrected" in found.notes[0]
    assert found.summary() == {
        "offset_px": 0.4,
        "bow_px": 1.2,
        "row_offset_px": 0.0,
        "residual_px": 0.2,
        "source": "my labels",
        "is_applied": True,
        "look_s": 0.0,
    }
    with pytest.raises(RigError, match=r"none\.yaml"):
        find_alignment(str(tmp_path / "none.yaml"), RIG, never())


def test_what_is_measured_but_not_clear_stays_as_doubt():
    found = FoundAlignment(measured=Alignment(offset_px=-0.12, offset_sigma_px=0.1, residual_px=0.16), is_applied=False)
    assert (found.applied.offset_px, found.applied.residual_px) == (0.0, pytest.approx(0.2))  # hypot(0.12, 0.16)
    assert "no clear error" in found.notes[0]
    wild = FoundAlignment(measured=Alignment(offset_px=3.0, offset_sigma_px=2.0, residual_px=2.0), is_applied=False)
    assert wild.applied.residual_px == UNCORRECTED_SIGMA_PX


@pytest.mark.parametrize(("row_px", "moved_px"), [(0.29, 0.0), (-0.31, -0.31), (2.0, 2.0)])
def test_rows_are_moved_from_a_third_of_a_pixel_on(row_px, moved_px):
    found = FoundAlignment(measured=Alignment(row_offset_px=row_px), is_applied=False)
    assert found.measured.rows_to_move_px == moved_px
    assert any("corrected, but the rig" in note for note in found.notes) == (moved_px != 0)


@pytest.fixture(scope="module")
def drive():
    renderer = Renderer(make_scene(4, seconds=2.0), RIG)
    return [
        Frame(i, i / 10, renderer.render(i / 10, eye="left"), renderer.render(i / 10, eye="right")) for i in range(17)
    ]


def test_a_drive_tells_its_own_alignment(drive):
    steps = []

    class Bar:
        def __enter__(self):
            return lambda done, total: steps.append((done, total))

        def __exit__(self, *_):
            return None

    found = find_alignment("auto", RIG, (frame for frame in drive), lambda text: Bar())
    assert abs(found.measured.offset_px) < 0.3
    assert abs(found.measured.row_offset_px) < 0.1
    assert "this drive" in found.notes[0]
    assert found.look_s > 0
    assert steps[0] == (0, 80)


def test_a_vehicle_that_stands_still_tells_nothing_but_its_rows(drive):
    still = [Frame(i, i / 10, drive[0].left, drive[0].right) for i in range(12)]
    found = find_alignment("auto", RIG, (frame for frame in still))
    assert not found.is_applied
    assert found.applied.residual_px == UNCORRECTED_SIGMA_PX
    assert "stands still" in found.notes[0]
