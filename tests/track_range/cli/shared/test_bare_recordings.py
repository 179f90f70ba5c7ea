"""Recordings without --mono or --stereo, and patterns that the shell has expanded."""

import pytest


def test_one_recording_is_a_run_of_one_camera(cli):
    status, _, complaint = cli("none.mp4", "--focal-px", 700)
    assert status == 1
    assert complaint.splitlines()[0] == "track-range --mono none.mp4 --focal-px 700"
    assert "none.mp4: no such file" in complaint


def test_two_recordings_may_be_a_pair_or_parts(cli):
    status, _, complaint = cli("a b.mp4", "c.mp4", "--rig", "rig.yaml")
    assert status == 2
    assert "`track-range --stereo 'a b.mp4' c.mp4`" in complaint
    assert "`track-range --mono 'a b.mp4' --mono c.mp4`" in complaint


@pytest.mark.parametrize(
    ("arguments", "advice"),
    [
        (["d/a_00.jpg", "d/a_01.jpg", "d/a_02.jpg"], "--mono 'd/a_*.jpg'"),
        (["run", "--mono", "front.mp4", "rear.mp4", "side.mp4"], "--mono '*.mp4'"),
        (["--mono", "0001.png", "0002.png", "0003.png", "--focal-px", "700"], "--mono '*.png'"),
        (
            ["--stereo", "left1.jpg", "left2.jpg", "right1.jpg", "right2.jpg"],
            "--stereo 'left*.jpg' 'right*.jpg'",
        ),
        (["--mono", "a.mp4", "b.mp4"], "--mono a.mp4 --mono b.mp4 for the parts of one recording"),
        (
            ["calibrate", "--mono", "l1.jpg", "l2.jpg", "l3.jpg", "--board", "9x6"],
            "--mono 'l*.jpg'",
        ),
    ],
)
def test_expanded_patterns_are_to_be_quoted(cli, arguments, advice):
    status, _, complaint = cli(*arguments)
    assert (status, advice in complaint) == (2, True), complaint


def test_recordings_of_calibrate_name_both_commands(cli):
    status, _, complaint = cli("calibrate", "a.mp4", "b c.mp4", "--out", "rig.yaml")
    assert status == 2
    assert "`track-range calibrate drive a.mp4 'b c.mp4'`" in complaint
    assert "`track-range calibrate --mono a.mp4`" in complaint
    assert "No such command" not in complaint


@pytest.mark.parametrize("words", [["demoo"], ["calibrate", "drives"]])
def test_other_words_are_no_recordings(cli, words):
    status, _, complaint = cli(*words)
    assert (status, "No such command" in complaint) == (2, True)


def test_names_of_detectors_are_whole_at_80_columns():
    from tests.support.command_line import run_command

    shown = run_command("models", "list", width=80).stdout
    assert "Megvii-BaseDetection/YOLOX" in shown
    assert max(map(len, shown.splitlines()[:-1])) <= 80
