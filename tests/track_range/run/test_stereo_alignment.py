"""Tests of the alignment that a run applies, and of its notes."""

from dataclasses import replace

import pytest

from track_range.recording.cameras.auto_alignment import PairAlignment, given_alignment
from track_range.recording.cameras.calibration import calibration_of
from track_range.recording.pairs.aligner import RECORDED, PairAligner
from track_range.recording.video.frame import RecordedFrame
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scene import make_scene
from track_range.stereo.alignment.file import save_alignment
from track_range.stereo.alignment.health import Window
from track_range.stereo.geometry.alignment import UNCORRECTED_SIGMA_PX, Alignment
from track_range.stereo.geometry.rig import RigError

RIG = kitti_like_rig(width_px=620, height_px=188)


def estimated(recorded):
    """The alignment estimated from first frames that are read ahead."""
    aligner = PairAligner(calibration_of(RIG, (RIG.left.size_px, RIG.right.size_px)), RECORDED)
    for frame in recorded:
        aligner.look(frame)
    aligner.start()
    return aligner.calibration.alignment


def test_alignment_off():
    alignment = given_alignment("off", RIG)
    assert not alignment.is_applied
    assert (alignment.applied.offset_px, alignment.applied.residual_px) == (
        0.0,
        UNCORRECTED_SIGMA_PX,
    )
    (note,) = alignment.notes
    assert "off" in note


def test_alignment_file(tmp_path):
    written = Alignment(
        offset_px=0.4, curvature_px=1.2, offset_sigma_px=0.1, residual_px=0.2, source="my labels"
    )
    save_alignment(written, tmp_path / "align.yaml")
    alignment = given_alignment(str(tmp_path / "align.yaml"), RIG)
    assert (alignment.is_applied, alignment.applied) == (True, written)
    assert "my labels" in alignment.notes[0]
    summary = alignment.summary()
    assert summary.pop("health")["state"] == "off"
    assert summary == {
        "offset_px": 0.4,
        "bow_px": 1.2,
        "row_offset_px": 0.0,
        "residual_px": 0.2,
        "source": "my labels",
        "is_applied": True,
        "look_s": 0.0,
        "offset_sigma_px": 0.1,
        "slope_px": 0.0,
        "roll_deg": 0.0,
        "focal_ratio": 1.0,
        "yaw_deg": 0.0,
    }
    with pytest.raises(RigError, match=r"none\.yaml"):
        given_alignment(str(tmp_path / "none.yaml"), RIG)


def test_insignificant_alignment_is_uncertainty():
    alignment = PairAlignment(
        measured=Alignment(offset_px=-0.12, offset_sigma_px=0.1, residual_px=0.16), is_applied=False
    )
    assert alignment.applied.offset_px == 0.0
    assert alignment.applied.residual_px == pytest.approx(0.2)  # hypot(0.12, 0.16)
    assert len(alignment.notes) == 1
    wild = PairAlignment(
        measured=Alignment(offset_px=3.0, offset_sigma_px=2.0, residual_px=2.0), is_applied=False
    )
    # an offset that is known less well than that of a rig as it is
    assert wild.applied.residual_px == 2.0


@pytest.mark.parametrize(("row_px", "moved_px"), [(0.29, 0.0), (-0.31, -0.31), (2.0, 2.0)])
def test_rows_are_moved_from_0_3_px(row_px, moved_px):
    alignment = PairAlignment(measured=Alignment(row_offset_px=row_px), is_applied=False, rig=RIG)
    assert alignment.measured.row_correction_px == moved_px
    assert any("vertical offset" in note for note in alignment.notes) == (moved_px != 0)


def test_a_movement_is_noted_by_one_measurement():
    """`RightCameraMonitor` states it in the frame that shows it; the alignment is from before."""
    measured = Alignment(offset_sigma_px=0.02, residual_px=0.06, source="this drive")
    windows = tuple(
        Window(0, 2.0 * k, 2.0 * k + 1.6, offset_px, 0.03)
        for k, offset_px in enumerate((0.0, 0.02, 0.41, 0.39))
    )
    alignment = PairAlignment(measured=measured, is_applied=False, rig=RIG, windows=windows)
    assert alignment.health.move is not None
    assert [note.split(":")[0] for note in alignment.notes] == ["Alignment", "Rig"]
    assert "fits the images that were aligned" in alignment.notes[1]


def rendered(n_frames):
    renderer = Renderer(make_scene(4, seconds=2.0), RIG)
    for i in range(n_frames):
        images = tuple(renderer.render(i / 10, side=side) for side in ("left", "right"))
        yield RecordedFrame(i, i / 10, images)


@pytest.mark.slow
def test_alignment_from_the_drive():
    alignment = estimated(rendered(17))
    assert abs(alignment.measured.offset_px) < 0.3
    assert abs(alignment.measured.row_offset_px) < 0.1
    assert "this drive" in alignment.notes[0]
    assert alignment.estimation_s > 0


def test_static_vehicle_gives_no_alignment():
    (first,) = rendered(1)
    alignment = estimated([replace(first, index=i, time_s=i / 10) for i in range(12)])
    assert not alignment.is_applied
    assert alignment.applied.residual_px == UNCORRECTED_SIGMA_PX
