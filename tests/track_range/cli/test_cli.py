"""The command line as a whole: lazy imports, bare options, completion."""

import os
import subprocess
import sys
import traceback

import pytest
import typer

from track_range.cli.app import COMMANDS, _report_note, app, main
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.video_labels.csv_labels import OPTIONAL, REQUIRED
from track_range.detection.yolo.input_format import LETTERBOXES
from track_range.results.writers import DEFAULT_WRITERS
from track_range.run.options.settings import RunSettings
from track_range.stereo.evaluation.box_matchers import MATCHER_NAMES

HEAVY = ("numpy", "cv2", "onnxruntime", "av", "scipy", "matplotlib", "pyarrow", "torch")


@pytest.mark.parametrize(
    "arguments", [[], ["--help"], ["run", "--help"], ["evaluate", "--help"], ["--version"]]
)
def test_help_imports_no_heavy_library(arguments):
    code = (
        "import sys\n"
        "from track_range.cli.app import main\n"
        f"sys.argv = ['track-range', *{arguments!r}]\n"
        "try:\n    main()\nfinally:\n"
        f"    print('HEAVY', [name for name in {HEAVY!r} if name in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "HEAVY []"


def test_overview_without_arguments(cli):
    status, text, _ = cli()
    lines = text.splitlines()
    assert (status, len(lines)) == (0, 10)
    assert max(map(len, lines)) < 80
    for word in ("demo", "--mono", "--stereo", "--help", "doctor"):
        assert word in text


BROKEN_TRACKER = """
class Broken:
    def __init__(self, options):
        pass

    def update(self, detections, time_s, image):
        raise ZeroDivisionError("a defect")
"""


def test_unexpected_error_asks_for_a_report(cli, tmp_path, monkeypatch):
    (tmp_path / "broken_tracker.py").write_text(BROKEN_TRACKER)
    (tmp_path / "det.txt").write_text("1,-1,10,10,30,60,0.9\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ZeroDivisionError) as raised:
        cli(
            "track",
            tmp_path / "det.txt",
            "--out",
            tmp_path / "out",
            "--tracker",
            "broken_tracker:Broken",
        )
    last_line = "".join(traceback.format_exception(raised.value)).splitlines()[-1]
    for words in ("report", "track-range doctor", "--tracker broken_tracker:Broken"):
        assert words in last_line


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_full_output_is_a_user_error():
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "track_range", "report", "--help"]
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert ended.returncode == 1
    assert "no space" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_report_line_hides_passwords():
    assert "secret" not in _report_note(["--mono", "rtsp://user:secret@camera/stream"])


def test_user_error_asks_for_no_report(cli):
    status, _, complaint = cli("--mono", "none.mp4", "--focal-px", 700)
    assert (status, "report" in complaint, "Traceback" in complaint) == (1, False, False)


def test_every_command_can_be_imported():
    group = typer.main.get_command(app)
    assert list(group.commands) == list(COMMANDS)
    for name in COMMANDS:
        command = group.load(name)
        assert (command.name, command.help) == (name, COMMANDS[name].summary)
        for below in getattr(command, "modules", {}):
            assert command.load(below).name == below


def test_unknown_command_is_wrong_usage(cli):
    status, _, complaint = cli("evalute")
    assert (status, "evaluate" in complaint) == (2, True)


def test_bare_options_mean_run(cli):
    status, _, complaint = cli("--mono", "none.mp4", "--rig", "r.yaml", "--focal-px", 700)
    assert (status, "--rig or --focal-px" in complaint) == (2, True)


@pytest.mark.parametrize(
    ("words", "completed"),
    [
        (["ev"], ["evaluate"]),
        (["--overlay-d"], ["--overlay-disparity"]),
        (["--stereo", "a", "b", "--truth-c"], ["--truth-calib"]),
        (
            ["run", "--device", ""],
            ["auto", "cpu", "cuda", "tensorrt", "openvino", "coreml", "directml"],
        ),
        (["evaluate", "ra"], ["ranges"]),
        (["calibrate", "dr"], ["drive"]),
        (["calibrate", "--mo"], ["--mono"]),
        (["calibrate", "drive", "--known-l"], ["--known-lane-width"]),
        (["evaluate", "ranges", "--fil"], ["--filter"]),
    ],
)
def test_completion_of_commands_and_options(monkeypatch, capsys, words, completed):
    monkeypatch.setattr(os, "environ", dict(os.environ))
    os.environ |= {
        "COMP_WORDS": "\n".join(["track-range", *words]),
        "COMP_CWORD": str(len(words)),
        "_TRACK_RANGE_COMPLETE": "complete_bash",
    }
    monkeypatch.setattr(sys, "argv", ["track-range"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    assert capsys.readouterr().out.split() == completed


def test_completion_script_can_be_shown(cli, monkeypatch):
    # the tests' parent need not be a shell
    monkeypatch.setenv("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", "1")
    status, script, _ = cli("--show-completion", "bash")
    assert (status, "_TRACK_RANGE_COMPLETE=complete_bash" in script) == (0, True)


def test_names_in_help_texts():
    """Help texts repeat names of the code, because importing it takes longer than showing the
    help."""
    shown = {name: field.description for name, field in RunSettings.model_fields.items()}
    assert all(name in shown["classes"] for name in ROAD_CLASSES)
    assert LETTERBOXES in shown["letterbox"]
    assert ", ".join(REQUIRED) in shown["truth"]
    assert ", ".join(OPTIONAL) in shown["truth"]
    assert RunSettings.model_fields["write"].default == DEFAULT_WRITERS
    from track_range.calibration.settings import StereoEvaluationSettings

    matchers = StereoEvaluationSettings.model_fields["matchers"].description
    assert all(name.removesuffix("-centre") in matchers for name in MATCHER_NAMES)
