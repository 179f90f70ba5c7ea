"""Every reader takes 200 kB of any character, and of the starts of its own expressions, without a crash, and
in time that does not grow with the square of the file.

The readers are those of the product's tables, so that a new format is tested without a change here.
"""

import re
import string
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.repository.patterns import (
    N_BYTES,
    TooSlow,
    expressions_of,
    processor_limit,
    product_modules,
)
from tests.track_range.recording.telemetry.mp4_files import MadeTrack, box, mp4
from track_range.detection.catalogue.darknet.network import read_network
from track_range.detection.formats.detection_files import read_detections
from track_range.detection.formats.label_formats import LABEL_FORMATS, read_labels
from track_range.detection.formats.tables.box_table import VideoFacts
from track_range.detection.formats.tables.label_format import LabelFormat
from track_range.detection.training.data_yaml import read_data_yaml
from track_range.detection.yolo.metadata import ModelOptions, read_metadata
from track_range.fleet.inputs.manifest import manifest_clips
from track_range.fleet.storage.location import Location
from track_range.foundation.errors import UserError
from track_range.foundation.files.csv_tables import read_csv_table
from track_range.foundation.files.structured_text import read_json, read_yaml
from track_range.ranging.size_models.curve import load_curves
from track_range.recording.sources.files.image_names import named_images
from track_range.recording.telemetry.containers.mp4_boxes import read_movie
from track_range.recording.telemetry.exiftool import track_of_records
from track_range.recording.telemetry.found import READERS, embedded
from track_range.recording.telemetry.sidecars.reading import SIDECARS
from track_range.recording.telemetry.sidecars.sidecar import Sidecar
from track_range.recording.telemetry.speed_files import open_ego_speed
from track_range.results.events.files import read_events
from track_range.results.formats.csv_file import read_tracks_csv
from track_range.run.options.settings_file import read_settings
from track_range.stereo.alignment.file import load_alignment
from track_range.stereo.rig_formats.reading import RIG_FORMATS, read_calibration
from track_range.stereo.rig_formats.rig_format import RigFormat

LIMIT_S = 20.0  # of one file; readers need less than 1 s
# all characters but letters and digits, of which some stand for the others
CHARACTERS = [*string.punctuation, *" \n\t\r\0é", *"aeEN019"]
NESTED = ('{"a":', "[{", "<a>", "- - ", "{a: ", "[ ", "a: [\n", "<a b='", "(", "a.", "0,", "0 ")

Read = Callable[[Path], object]


def of_rig(form: RigFormat, path: Path) -> object:
    text = path.read_text()
    if form.recognises(text) or len(set(text)) == 1:
        return form.read(text, path, False)
    return None


def of_any_rig(path: Path) -> object:
    with suppress(UserError):
        read_calibration(path, is_grey=False, is_pair=False)
    return read_calibration(path, is_grey=False, is_pair=True)


def of_labels(form: LabelFormat, path: Path) -> object:
    return form.read(path, VideoFacts("drive", 100, size_px=(640, 480), fps=10.0))


def of_sidecar(sidecar: Sidecar, path: Path) -> object:
    return sidecar.read(path, "drive.mp4", 60.0)


def of_container(read: Callable[..., object], path: Path) -> object:
    """The telemetry in a movie that has the content in boxes and tracks of all kinds."""
    content = path.read_bytes()
    movie = path.with_name("drive.mp4")
    boxes = [box(kind, content) for kind in (b"free", b"skip", b"GPS ", b"gps ")]
    boxes.append(box(b"free", b"\0\0\0\0" + box(b"gps ", content)))
    boxes.append(box(b"free", b"freeGPS " + content))
    tracks = [
        MadeTrack(handler, form, [content])
        for handler, form in (
            (b"vide", b"avc1"), (b"meta", b"gpmd"), (b"meta", b"camm"), (b"text", b"text"), (b"subp", b"mp4s"),
        )
    ]  # fmt: skip
    movie.write_bytes(
        mp4(tracks, top=b"".join(boxes), inner=box(b"udta", box(b"gps ", content)), between=content)
    )
    with movie.open("rb") as file:
        found = read_movie(file)
        assert found is not None
        # as `found.embedded` does
        with suppress(ValueError, IndexError, OverflowError, struct.error):
            return read(file, found, movie)


def of_ligogps(path: Path) -> object:
    content = path.read_bytes()
    path.write_bytes(
        mp4([], end=content + b"&&&&" + struct.pack(">I", len(content) + 8), top=content)
    )
    return embedded(path)


def of_transport_stream(path: Path) -> object:
    content = path.read_bytes()
    packets = [
        b"\x47\x42\x00\x10" + content[at : at + 184].ljust(184) for at in range(0, N_BYTES, 184)
    ]
    path.write_bytes(b"".join(packets))
    return embedded(path)


def of_bare_gpmf(path: Path) -> object:
    path.write_bytes(b"DEVC" + path.read_bytes())
    return embedded(path)


def of_exiftool(path: Path) -> object:
    text = path.read_text()
    names = (text, f"Doc{text}", f"Doc1:{text}", "Doc1:GPSDateTime", "Doc1:SampleTime")
    return track_of_records(dict.fromkeys((*names, "Doc1:GPSLatitude"), text))


def of_times(path: Path) -> object:
    """The times of a folder of images, one of which has a long name."""
    image = cv2.imencode(".png", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    for number, stem in enumerate(("000001", "000002", path.read_text()[:200])):
        with suppress(OSError, ValueError):  # of names that the system refuses
            path.with_name(f"{stem}{number}.png").write_bytes(image)
    path.rename(path.with_name("timestamps.txt"))
    return named_images(path.parent)


def of_metadata(path: Path) -> object:
    text = path.read_text()
    return read_metadata(Path("model.onnx"), {"names": text, "anchors": text}, ModelOptions())


def of_data_yaml(path: Path) -> object:
    path.with_name("list.txt").write_text(path.read_text())
    listing = path.with_name("listing.yaml")
    listing.write_text("train: list.txt\nval: list.txt\nnames: [car]\n")
    with suppress(UserError):
        read_data_yaml(listing)
    return read_data_yaml(path)


def own_module(function: Callable[..., object]) -> str:
    """Module of a reader in the product; "" = it is a lambda of a table."""
    name = getattr(function, "__module__", "").removeprefix("track_range.")
    return "" if getattr(function, "__name__", "") == "<lambda>" else name


READ: dict[str, tuple[Read, str, str]] = {  # function, suffix, folder or module of its expressions
    **{
        f"rig {form.name}": (partial(of_rig, form), ".txt", own_module(form.read))
        for form in RIG_FORMATS.usable.values()
    },
    **{
        f"labels {form.name}": (partial(of_labels, form), ".txt", own_module(form.read))
        for form in LABEL_FORMATS.usable.values()
    },
    **{
        f"sidecar {name} {sidecar.suffixes[0]}": (
            partial(of_sidecar, sidecar), sidecar.suffixes[0], own_module(sidecar.read),
        )
        for name, sidecar in SIDECARS.usable.items()
    },
    **{
        f"container {read.__name__}": (
            partial(of_container, read), ".bin", own_module(read),
        )
        for read in READERS
    },
    "rig of any format": (of_any_rig, ".yaml", "stereo.rig_formats"),
    "labels of any format": (read_labels, ".txt", "detection.formats"),
    "detections": (read_detections, ".txt", "detection.formats"),
    "GPS after a movie": (of_ligogps, ".mp4", "recording.telemetry.containers"),
    "transport stream": (of_transport_stream, ".ts", "recording.telemetry.containers"),
    "bare GPMF": (of_bare_gpmf, ".mp4", "recording.telemetry.containers"),
    "exiftool": (of_exiftool, ".txt", "recording.telemetry.exiftool"),
    "times of images": (of_times, ".csv", "recording.sources.files"),
    "YAML": (lambda path: read_yaml(path, UserError, "a file"), ".yaml", "foundation"),
    "JSON": (lambda path: read_json(path, UserError, "a file"), ".json", "foundation"),
    "CSV": (lambda path: read_csv_table(path, UserError, "a table"), ".csv", "foundation"),
    "settings": (read_settings, ".yaml", "run"),
    "alignment": (load_alignment, ".json", "stereo.alignment"),
    "sizes": (load_curves, ".json", "ranging"),
    "manifest of a fleet": (
        lambda path: manifest_clips(Location.of(path)), ".csv", "fleet.inputs",
    ),
    "ego speed": (lambda path: open_ego_speed(str(path)), ".csv", "ranging"),
    "rows of a run": (read_tracks_csv, ".csv", "results"),
    "events of a run": (read_events, ".csv", "results"),
    "Darknet cfg": (read_network, ".cfg", "detection.catalogue.darknet"),
    "metadata of a model": (
        of_metadata, ".txt", "detection.yolo",
    ),
    "training data": (of_data_yaml, ".yaml", "detection.training"),
}  # fmt: skip


@cache
def starts_in(folder: str) -> tuple[str, ...]:
    """The starts of all expressions in a folder of the product."""
    starts: dict[str, None] = {}
    for name, file in product_modules():
        if folder and f"{name}.".startswith(f"track_range.{folder}."):
            for expression in expressions_of(name, file):
                starts |= dict.fromkeys(expression.starts())
    return tuple(starts)


def texts_of(folder: str) -> Iterator[str]:
    """200 kB of each character, and of each start."""
    for unit in dict.fromkeys((*CHARACTERS, *NESTED, *starts_in(folder))):
        yield unit * (N_BYTES // len(unit))


@pytest.mark.slow
@pytest.mark.parametrize("name", READ)
def test_reader_is_linear_and_has_its_own_errors(name: str, tmp_path: Path) -> None:
    read, suffix, folder = READ[name]
    for number, text in enumerate(texts_of(folder)):
        place = tmp_path / str(number)
        place.mkdir()
        path = place / f"file{suffix}"
        path.write_text(text, newline="")
        try:
            with processor_limit(LIMIT_S), suppress(UserError):
                read(path)
        except TooSlow:
            pytest.fail(f"{name} is slow for {text[:30]!r}...")
        except Exception as error:  # a crash of any kind
            pytest.fail(f"{name} fails with {error!r:.200} for {text[:30]!r}...")
        for file in place.iterdir():
            file.unlink()
        place.rmdir()


def test_expressions_of_the_readers_are_found() -> None:
    starts = starts_in("stereo.rig_formats")
    assert len(starts) > 100
    assert any(re.match(r"cam0\s*=", start) for start in starts)
    assert any(start.endswith("RMC,") for start in starts_in("recording.telemetry.sidecars"))
