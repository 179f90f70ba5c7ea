"""The wheel, and the wheel built from the sdist: one top-level name, and a program that runs from
anywhere."""

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow  # builds, and runs an installed program

PROJECT = Path(__file__).resolve().parents[2]


def build_into(folder, source, kind):
    command = [
        sys.executable,
        "-m",
        "build",
        "--no-isolation",
        f"--{kind}",
        "--outdir",
        str(folder),
        str(source),
    ]
    subprocess.run(command, check=True, capture_output=True, env=environment())
    return next(folder.glob("*.whl" if kind == "wheel" else "*.tar.gz"))


def environment():
    """Without PYTHONPATH: the checkout must not be what is imported."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """Wheel by where it was built from: the checkout, and an unpacked sdist."""
    folder = tmp_path_factory.mktemp("packages")
    sdist = build_into(folder / "sdist", PROJECT, "sdist")
    subprocess.run(["tar", "-xzf", sdist, "-C", folder], check=True)
    unpacked = folder / sdist.name.removesuffix(".tar.gz")
    return {
        "checkout": build_into(folder / "checkout", PROJECT, "wheel"),
        "sdist": build_into(folder / "from_sdist", unpacked, "wheel"),
    }


def names_in(wheel):
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


@pytest.mark.parametrize("source", ["checkout", "sdist"])
def test_wheel_holds_one_top_level_name(wheels, source):
    names = names_in(wheels[source])
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"track_range"}
    assert {
        "track_range/detection/weights/road.onnx",
        "track_range/detection/weights/road-licensed.onnx",
        "track_range/ranging/size_models/curves/cuboids.json",
        "track_range/views/report/assets/script/start.js",
        "track_range/stereo/geometry/camera.py",
        "track_range/tracking/deepsort.py",
    } <= names


def test_wheel_of_sdist_equals_wheel_of_checkout(wheels):
    assert names_in(wheels["sdist"]) == names_in(wheels["checkout"])


@pytest.fixture(scope="module")
def installed(wheels, tmp_path_factory):
    """Python of an environment with the sdist's wheel; libraries are those of this environment."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False)
    python = folder / "bin" / "python"
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder), "platbase": str(folder)}))
    with zipfile.ZipFile(wheels["sdist"]) as archive:
        archive.extractall(site)
    # .pth files in there are not followed: not the editable install
    libraries = sysconfig.get_path("purelib")
    (site / "libraries.pth").write_text(f"{libraries}\n")
    return python


def run_python(python, *arguments, cwd):
    return subprocess.run(
        [python, *arguments], cwd=cwd, env=environment(), capture_output=True, text=True
    )


def test_packages_import_from_a_foreign_folder(installed, tmp_path):
    code = (
        "import track_range, track_range.detection, track_range.stereo; print(track_range.__file__)"
    )
    done = run_python(installed, "-c", code, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).is_relative_to(installed.parents[1])


@pytest.mark.parametrize("package", ["detection", "tracking", "stereo", "ranging"])
def test_bare_package_name_does_not_import(installed, tmp_path, package):
    done = run_python(installed, "-c", f"import {package}", cwd=tmp_path)
    assert "ModuleNotFoundError" in done.stderr


def test_demo_runs_from_a_foreign_folder(installed, tmp_path):
    options = ["demo", "--out", "demo", "--seconds", "0.5", "--playback"]
    done = run_python(installed, "-m", "track_range", *options, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "demo").is_dir()
    assert list((tmp_path / "demo").rglob("tracks.csv"))
