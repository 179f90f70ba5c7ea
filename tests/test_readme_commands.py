"""Every command of README runs as it stands, in a folder with the files that it names, and leaves what is promised.

A new command of a known kind needs no change here, a new input a line in `readme_inputs.py`.
"""

import fnmatch
import re
import shlex
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest

from tests.readme_inputs import lay, write_inputs
from tests.readme_lines import PROJECT, README, command_of, commands
from track_range.cli.app import main
from track_range.detection.models.catalogue import CATALOGUE

TRACK_RANGE = Path(sys.executable).with_name("track-range")

RESULTS = re.findall(r"`([a-z0-9_]+\.[a-z0-9]+)`", "".join(re.findall(r"^\| (`.*?) \|", README, re.MULTILINE)))
"""The files that README's table of results names."""

PROMISED = {
    "run": ([f"{{out}}/{name}" for name in RESULTS], ("ms/frame", "Results in ", "{out}: ")),
    "calibrate": (
        ["rig.png"],
        ("Board found in 7 of 7 pairs.", "Views used", "±", "Warning: left: no corners near"),
    ),
    "rig show": ([], ("across", "degrees; rectified", "baseline 0.5400 m", "What a disparity means")),
    "rig convert": (["rig.yaml"], ("Written: rig.yaml, two cameras.",)),
    "align": ([], ("Alignment:", "px")),
    "evaluate stereo": ([], ("median", "patch", "sgbm-hh", "alignment leave-two-out")),
    "models list": ([], (*(entry.name for entry in CATALOGUE), "licence", "AGPL-3.0", "packaged")),
    "models info": ([], ("yolov4-tiny", "road classes", "from the model's metadata")),
    "models import": ([], ("38 layers",)),
    "models quantize": (["mine-int8.onnx", "mine-fp16.onnx"], ("AP50 %", "Speed per image")),
    "evaluate detections": ([], ("AP50 % by class", "Speed per image")),
    "anchors": ([], ("mean best IoU with these 9",)),
    "track": (["{out}/mot/*.txt"], ("Written: tracks/mot",)),
    "evaluate tracks": ([], ("HOTA", "IDF1", "together")),
    "fit": ([], ("height", "car", "person")),
    "evaluate ranges": ([], ("diagonal-5", "mono", "3 folds over 3 sequences")),
    "report": (["{first}/report.html"], ("Open", "in a browser")),
}
"""By command: files that are there afterwards, and words that are printed."""

BEGUN = {
    "track-range train --data data.yaml --model yolov5n --size 416 --epochs 100 --out runs/mine": (
        "runs/mine/last.pt",
        "track-range: stopped by the user; --resume goes on with the run in runs/mine.",
    ),
    "track-range simulate --out sim --images 360": ("sim/images/*.jpg", "track-range: stopped by the user."),
    "track-range simulate --out drive --scenario city": ("drive/left.mp4", "track-range: stopped by the user."),
}
"""Minutes of work, whose ends test_train.py and test_simulate.py see on less: begun as they stand, and stopped by
Ctrl-C when there is a first file of the name given, which is answered in one sentence."""

REFUSED = {
    "track-range models pull yolov4-tiny": r"https://\S+: cannot be reached \(.*\)\. Try again later .*",
    "track-range --stereo 0 1 --rig rig.yaml --show": r"/dev/video0: this camera cannot be opened .*",
    "track-range --mono rtsp://CAMERA/stream --focal-px 1150 --serve 8000": (
        r"rtsp://CAMERA/stream: this stream cannot be opened .*|--serve \S+:8000: cannot be served there .*"
    ),
}
"""What wants a network or a camera, and the one sentence that it ends with where there is none."""

EXCUSED = {
    "make demo": ("takes minutes; test_demo of test_end_to_end.py runs a shorter one", "make -n demo"),
    "make test": ("this is in it", "make -n test"),
    "python -m benchmarks recall --model yolov5n.onnx": (
        "wants YOLOv5n, and minutes",
        "python -m benchmarks recall --help",
    ),
    "pip install .": ("wants the package index; test_what_is_installed_has_the_extras_named", None),
    "pip install '.[train]'": ("as above", None),
}
"""What cannot be run here, why, and a command in its place that succeeds."""

WHOLE = [line for line in commands() if line not in {**BEGUN, **REFUSED, **EXCUSED}]


@pytest.fixture(scope="session")
def store(tmp_path_factory):
    """Files of all names that README uses."""
    return write_inputs(tmp_path_factory.mktemp("store"))


@pytest.fixture
def desk(store, tmp_path, monkeypatch):
    """Lays a command's files into an empty folder and goes there; gives its words."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TRACK_RANGE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("https_proxy", "http://127.0.0.1:9")  # where nobody answers: no test fetches anything
    monkeypatch.delenv("no_proxy", raising=False)

    def laid(line):
        words = shlex.split(line)
        lay(store, words, tmp_path)
        return words

    return laid


@pytest.fixture
def track_range(desk, capsys, monkeypatch):
    """Runs a line in this process: status, what it printed, what it complained of, and the files that it wrote."""

    def run(line):
        monkeypatch.setattr(sys, "argv", desk(line))
        before = written()
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return int(ended.value.code or 0), printed.out, printed.err, {path for path, _ in written() - before}

    return run


def written():
    """Every file here, and when it was written."""
    return {(path.as_posix(), path.stat().st_mtime_ns) for path in Path().rglob("*") if path.is_file()}


def after(words, option, otherwise=""):
    return words[words.index(option) + 1] if option in words else otherwise


def place_of_results(words):
    """--out, or the settings' own folder, or that named after the left video."""
    settings, video = after(words, "--settings"), after(words, "--stereo", after(words, "--mono"))
    return after(words, "--out", settings.partition("/")[0] or f"{Path(video).stem}-track-range")


def promised(line):
    """Patterns of files and words, those of the options too."""
    name, _, rest = command_of(line)
    if "--help" in rest:
        return [], ["Usage", "--stereo"]
    assert name in PROMISED, f"{name}: say in PROMISED what README's reader gets of it"
    files, words = PROMISED[name]
    told = {"out": place_of_results(rest), "first": (rest or [""])[0]}
    files = [*(file.format(**told) for file in files), *(after(rest, option) for option in ("--out", "--table"))]
    more = ("Distance error, each method where it measured",) if "--truth" in rest and name == "run" else ()
    return [file for file in files if file], [word.format(**told) for word in (*words, *more)]


@pytest.mark.slow
@pytest.mark.parametrize("line", WHOLE, ids=str)
def test_it_runs_and_leaves_what_is_promised(track_range, line):
    assert line.startswith("track-range "), "neither track-range's nor excused"
    files, words = promised(line)
    status, printed, complaint, made = track_range(line)
    assert (status, complaint) == (0, "")
    told = " ".join(printed.split())
    assert [word for word in words if word not in told] == []
    assert [file for file in files if not fnmatch.filter(made, file) + fnmatch.filter(made, f"{file}/*")] == []
    assert [path for path in made if not Path(path).stat().st_size] == []


@pytest.mark.slow
@pytest.mark.parametrize("line", BEGUN, ids=str)
def test_it_begins_and_ctrl_c_ends_it(desk, line):
    first_file, said = BEGUN[line]
    process = subprocess.Popen(
        [TRACK_RANGE, *desk(line)[1:]],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heed_ctrl_c,
    )
    give_up_s = time.monotonic() + 120
    while not any(Path().glob(first_file)) and process.poll() is None and time.monotonic() < give_up_s:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, complaint = process.communicate(timeout=60)
    assert (process.returncode, complaint.strip()) == (1, said)
    assert list(Path().glob(first_file))


def heed_ctrl_c():
    """Where the tests themselves run in the background of a shell, programs they start would ignore SIGINT."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.parametrize("line", REFUSED, ids=str)
def test_what_is_missing_is_said_in_one_sentence(track_range, line):
    if "--show" in line and (sys.platform != "linux" or any(Path("/dev").glob("video*"))):
        pytest.skip("a camera may be here, and nobody asked to be filmed")
    status, _, complaint, _ = track_range(line)
    assert status == 1
    assert re.fullmatch(f"track-range: ({REFUSED[line]})\n", complaint), complaint


@pytest.mark.slow
@pytest.mark.parametrize("line", [line for line, (_, instead) in EXCUSED.items() if instead])
def test_what_stands_in_for_what_is_not_run(line):
    program, *rest = shlex.split(EXCUSED[line][1])
    program = sys.executable if program == "python" else program
    subprocess.run([program, *rest], cwd=PROJECT, check=True, capture_output=True)


def test_the_demo_of_make_goes_where_readme_says():
    recipe = subprocess.run(["make", "-n", "demo"], cwd=PROJECT, check=True, capture_output=True, text=True).stdout
    assert "track-range demo --out out/demo" in recipe
    assert "`out/demo`" in README


def test_what_is_installed_has_the_extras_named():
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text())["project"]
    extras = re.findall(r"pip install '\.\[(\w+)\]'", README)
    assert extras
    assert set(extras) <= set(project["optional-dependencies"])
    assert "Python 3.11 or newer" in README
    assert project["requires-python"] == ">=3.11"


def test_tables_here_are_of_readme():
    listed = [*BEGUN, *REFUSED, *EXCUSED]
    assert len(set(listed)) == len(listed)
    assert [line for line in listed if line not in commands()] == []
    named = {command_of(line)[0] for line in WHOLE}
    assert [name for name in PROMISED if name not in named] == []
    assert len(RESULTS) == 6
