"""Damaged text tables: every reader returns, or raises one short sentence that names the file."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.support.damaged_text import check_damaged, damaged
from tests.support.networks.darknet_networks import yolov3_tiny
from tests.support.results.events import event
from track_range.detection.catalogue.darknet.network import read_network
from track_range.detection.formats.detection_files import read_detections
from track_range.detection.formats.image_labels.labelled_images import read_manifest
from track_range.detection.formats.image_labels.yolo_labels import YoloLabelReader
from track_range.detection.formats.video_labels.csv_labels import read_csv_labels
from track_range.detection.formats.video_labels.kitti import read_kitti, read_kitti_image
from track_range.detection.formats.video_labels.mot import read_mot
from track_range.evaluation.events.scores import read_contacts
from track_range.evaluation.sequences.find import find_sequences
from track_range.ranging.truth.box_files import read_box_csv
from track_range.ranging.truth.truth import read_truth
from track_range.recording.telemetry.speed_files import open_ego_speed
from track_range.results.events.files import events_text, read_events
from track_range.results.folder import read_run_rows
from track_range.results.rows.columns import column_names
from track_range.run.options.opened import class_names
from track_range.stereo.geometry.camera import PinholeCamera

KITTI = """\
0 7 Car 0 1 -1.5 10 20 30 40 1.5 1.6 4.0 1.0 1.7 12.0 0.1
0 -1 DontCare -1 -1 -10 1 2 30 40 -1 -1 -1 -1000 -1000 -1000 -10
1 7 Car 0 0 -1.5 10 20 30 40 1.5 1.6 4.0 1.0 1.7 11.0 0.1 0.5
"""
LABELS = "frame,id,class,x1,y1,x2,y2,distance_m,closing_mps\n0,1,car,10,20,30,40,5.5,0.5\n1,1,car,10,20,30,40,5,nan\n"
BOXES = "class,x1,y1,x2,y2,distance_m,fx,track\ncar,1,2,33,44,5,700,1\nvan,2,2,33,44,6,700,1\n"
TRACKS = "".join(
    ",".join(
        {"frame": f"{frame}", "track_id": "3", "class": "car"}.get(name, "1.5")
        for name in column_names()
    )
    + "\n"
    for frame in range(3)
)
OXTS = " ".join(["49.01", "8.4", *["0.5"] * 28]) + "\n"
INFO = "[Sequence]\nname=A\nframeRate=25\nseqLength=12\nimWidth=640\nimHeight=480\n"
CAMERA = PinholeCamera(700, 700, 600, 180, 1242, 375)


def read_oxts(path):
    (path.parent / "timestamps.txt").write_text("2011-09-26 13:10:51.168593664\n")
    return open_ego_speed(str(path.parent))


def read_timestamps(path):
    (path.parent / "0000000000.txt").write_text(OXTS)
    return open_ego_speed(str(path.parent))


def read_info(path):
    (path.parent / "det").mkdir(exist_ok=True)
    (path.parent / "det/det.txt").touch()
    return find_sequences(path.parent, "det")


READERS = {
    "kitti": ("label.txt", KITTI, read_kitti),
    "kitti image": (
        "000000.txt",
        "Car 0 0 -1.5 1 2 30 40 1.5 1.6 4.0 1.0 1.7 11.0 0.1 0.5\n",
        read_kitti_image,
    ),
    "kitti truth": ("label.txt", KITTI, lambda path: read_truth(path, CAMERA, np.zeros(3))),
    "csv labels": ("truth.csv", LABELS, read_csv_labels),
    "det.txt": (
        "det.txt",
        "1,-1,11,21,5,6,0.5,-1,-1,-1\n3,-1,1,1,2,2,-1,-1,-1,-1\n",
        read_detections,
    ),
    "rrc": ("0000.txt", "0,1,2,3,4,0.5\n1,1,2,3,4,0.9\n", read_detections),
    "tracks as boxes": ("tracks.csv", f"{','.join(column_names())}\n{TRACKS}", read_detections),
    "tracks.csv": (
        "tracks.csv",
        f"{','.join(column_names())}\n{TRACKS}",
        lambda path: read_run_rows(path, []),
    ),
    "gt.txt": (
        "gt.txt",
        "1,5,4,1,3,10,1,1,0.25\n1,6,4,1,3,10,1,1,0.25\n2,5,5,1,3,10,0,7,1\n",
        read_mot,
    ),
    "yolo": (
        "a.txt",
        "0 .5 .5 .2 .2\n2 .5 .5 .1 .1 .9\n1 .1 .1 .2 .2 .3 .1\n",
        YoloLabelReader(("a", "b", "c")).read,
    ),
    "manifest": ("m.csv", "file,split,labels_complete\na.png,val,10101010\n", read_manifest),
    "ego speed": (
        "speed.csv",
        "time_s,speed_mps\n0,1.5\n1,9.66\n",
        lambda path: open_ego_speed(str(path)),
    ),
    "oxts": ("0000000000.txt", OXTS, read_oxts),
    "timestamps": (
        "timestamps.txt",
        "2011-09-26 13:10:51.16\n2011-09-26 13:10:51.26\n",
        read_timestamps,
    ),
    "boxes": ("boxes.csv", BOXES, read_box_csv),
    "events": (
        "events.csv",
        events_text([event(), event(kind="near_miss", warning_s=np.nan)]),
        read_events,
    ),
    "contacts": (
        "contacts.csv",
        "object_id,class,contact_s\n0,car,5.25\n3,person,7\n",
        read_contacts,
    ),
    "event labels": (
        "labels.csv",
        "kind,start_s,end_s\ncut_in,1,2\nnear_miss,3,4.5\n",
        read_events,
    ),
    "seqinfo.ini": ("seqinfo.ini", INFO, read_info),
    "names": ("names.txt", "car\nbus\nperson\n", lambda path: class_names(str(path))),
    "cfg": ("net.cfg", yolov3_tiny(size_px=(64, 64), n_classes=2, width=16), read_network),
}


@pytest.mark.parametrize("kind", READERS)
def test_intact_files_are_read(tmp_path: Path, kind: str) -> None:
    name, content, read = READERS[kind]
    assert check_damaged(read, tmp_path / name, content.encode()) is None


@pytest.mark.parametrize("kind", READERS)
@settings(
    deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damaged_files(tmp_path: Path, kind: str, data: st.DataObject) -> None:
    name, content, read = READERS[kind]
    check_damaged(read, tmp_path / name, data.draw(damaged(content.encode())))
