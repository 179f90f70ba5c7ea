"""Numbers of lines of the product and of the benchmarks, blank lines and docstrings included."""

from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]

# Raise only with a sentence of reason beside it. 75,000, 800 for distances of one camera on any road, 1,500 for checks
# of the inputs (scale, image size, synchronisation, order of the cameras), 2,500 for motion (its evaluation, time to
# collision from the scale of images, tracks in the world, measures of safety), 2,200 for recordings (stereo in one
# file, calibration files of cameras and tools, names of images), 2,000 for telemetry, labels and detectors of others,
# 700 for devices, live pace and speed, 500 for the console, the comparison of runs and sigmas of board calibrations.
MOST_LINES = 85_050
# Raise only with a sentence of reason beside it. 8,000, 350 for the faults of inputs that runs must notice, and 200 for
# the kinds of recordings and calibrations.
MOST_BENCHMARK_LINES = 8_550


def lines(*folders):
    """Number of lines of all Python files in folders, whose links are not followed."""
    files = [path for folder in folders for path in (PROJECT / folder).rglob("*.py")]
    return sum(path.read_bytes().count(b"\n") for path in files)


def test_product_does_not_grow():
    assert 10_000 < lines("detection", "tracking", "stereo", "ranging", "track_range") <= MOST_LINES


def test_benchmarks_do_not_grow():
    assert 1_000 < lines("benchmarks") <= MOST_BENCHMARK_LINES
