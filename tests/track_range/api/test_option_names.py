"""Errors name options as they were given: keywords in Python, flags on the command line."""

import pytest

import track_range as tr


@pytest.mark.parametrize(
    ("options", "beginning"),
    [
        ({"focal_px": -1}, r"^focal_px: expected a number above 0"),
        ({"duration": -1}, r"^duration_s: "),
        ({"size": 3}, r"^size_px: "),
        ({"rig": "rig.yaml", "focal_px": 700}, r"^give rig= or focal_px=, not both"),
        ({"clips": True, "overlay": False}, r"^clips=True .* overlay=False"),
        ({"tracker": "sort", "reid": "a.onnx"}, r"^reid: "),
        ({"focal": 700}, r"^focal: unknown option; did you mean focal_px\?"),
    ],
)
def test_errors_of_the_construction(options, beginning):
    with pytest.raises(tr.errors.UsageError, match=beginning) as raised:
        tr.Run.mono("a.mp4", **options)
    assert "--" not in str(raised.value)


def test_errors_of_the_opening(small_drive, cli, tmp_path):
    with pytest.raises(tr.errors.VideoError, match="omit topics="):
        tr.Run.mono(small_drive.left, topics=("/camera",)).open()
    with pytest.raises(tr.errors.VideoError, match="omit topics="):
        tr.open_recording(small_drive.left, topics=("/camera",))
    status, _, complaint = cli(
        "--mono", small_drive.left, "--topics", "/camera", "--out", tmp_path / "out"
    )
    assert (status, "omit --topics" in complaint) == (1, True)


class FailingDetector:
    """Finds nothing, and then an option is the cause of an error."""

    def __init__(self):
        self.n_images = 0

    def detect(self, image):
        self.n_images += 1
        if self.n_images > 3:
            raise tr.errors.ConfigError("--min-score: expected fewer boxes; give --classes.")
        return tr.Detections.empty()


def test_errors_during_a_run(small_drive, tmp_path):
    run = tr.Run.mono(small_drive.left, focal_px=700, detector=FailingDetector(), overlay=False)
    with pytest.raises(
        tr.errors.ConfigError, match=r"^min_score: expected fewer boxes; give classes="
    ):
        list(run)
    assert run.summary["frames"] > 0
    run = tr.Run.mono(small_drive.left, focal_px=700, detector=FailingDetector(), overlay=False)
    with pytest.raises(tr.errors.ConfigError, match=r"^min_score: "):
        run.write(tmp_path / "out")


def test_command_line_names_flags(cli):
    status, _, complaint = cli("--mono", "a.mp4", "--focal-px", -1)
    assert (status, "--focal-px: expected a number above 0" in complaint) == (2, True)


def test_errors_of_evaluations():
    with pytest.raises(tr.errors.UsageError, match=r"^min_lead_s: "):
        tr.evaluate.events("events.csv", "truth.csv", min_lead_s=-1)


def test_values_of_python(small_drive):
    """Numbers, paths and lists, where the command line has text."""
    settings = tr.Run.mono(
        small_drive.left,
        min_score=0.25,
        ego_speed=30,
        names=["car", "bus"],
        rig=small_drive.rig,
        size=320,
    ).settings
    assert (settings.min_score, settings.ego_speed, settings.names) == ("0.25", "30", "car,bus")
    assert (settings.rig, settings.size_px) == (small_drive.rig, "320")
