"""Small label files written by hand from the specification of each format, with the boxes that they
describe.

All of them describe the same two objects in a video of 100 x 50 px: a car that covers the pixel
columns 10 to 29 and rows 20 to 39 in the first frame, and is 10 columns further right in the third;
and a person in the third frame only, columns 50 to 54, rows 10 to 29. With pixel centres at
integers, the car's outer edges are 9.5, 19.5, 29.5, 39.5.
"""

from __future__ import annotations

from pathlib import Path

from track_range.detection.formats.tables.box_table import VideoFacts

CAR, CAR_LATER, PERSON = [9.5, 19.5, 29.5, 39.5], [19.5, 19.5, 39.5, 39.5], [49.5, 9.5, 54.5, 29.5]
SIZE = VideoFacts(size_px=(100, 50))


# https://cocodataset.org/#format-data: bbox is [x, y, width, height], "0-indexed" from the image's
# top left corner
COCO = """
{"info": {}, "licenses": [],
 "images": [{"id": 1, "width": 100, "height": 50, "file_name": "a_000000.png", "frame_index": 0, "video_id": 1},
            {"id": 3, "width": 100, "height": 50, "file_name": "a_000002.png", "frame_index": 2, "video_id": 1}],
 "videos": [{"id": 1, "name": "a"}],
 "annotations": [
  {"id": 1, "image_id": 1, "category_id": 3, "bbox": [10, 20, 20, 20], "area": 400, "iscrowd": 0, "track_id": 7,
   "segmentation": []},
  {"id": 2, "image_id": 3, "category_id": 3, "bbox": [20, 20, 20, 20], "area": 400, "iscrowd": 0, "track_id": 7},
  {"id": 3, "image_id": 3, "category_id": 1, "bbox": [50, 10, 5, 20], "area": 100, "iscrowd": 0, "track_id": 8}],
 "categories": [{"id": 1, "name": "person", "supercategory": "person"}, {"id": 3, "name": "car"}]}
"""


# https://docs.cvat.ai/docs/manual/advanced/xml_format/, version 1.1 for interpolation mode
CVAT = """<?xml version="1.0" encoding="utf-8"?>
<annotations>
  <version>1.1</version>
  <meta><task><id>4</id><name>a</name><size>3</size><mode>interpolation</mode><start_frame>0</start_frame>
    <stop_frame>2</stop_frame><original_size><width>100</width><height>50</height></original_size></task></meta>
  <track id="7" label="car" source="manual">
    <box frame="0" outside="0" occluded="0" keyframe="1" xtl="10.00" ytl="20.00" xbr="30.00" ybr="40.00" z_order="0">
      <attribute name="distance_m">12.5</attribute>
    </box>
    <box frame="1" outside="1" occluded="0" keyframe="1" xtl="10.00" ytl="20.00" xbr="30.00" ybr="40.00" z_order="0"/>
    <box frame="2" outside="0" occluded="1" keyframe="1" xtl="20.00" ytl="20.00" xbr="40.00" ybr="40.00" z_order="0"/>
  </track>
  <track id="8" label="person" source="manual">
    <box frame="2" outside="0" occluded="0" keyframe="1" xtl="50.00" ytl="10.00" xbr="55.00" ybr="30.00" z_order="0"/>
  </track>
</annotations>
"""


# readme.txt of KITTI's development kit for tracking: 0-based pixels, the box of track-range without
# a change
KITTI = """\
0 7 Car 0 0 -1.57 9.5 19.5 29.5 39.5 1.5 1.6 4.0 -3.0 1.6 20.0 -1.57
2 7 Car 0 0 -1.57 19.5 19.5 39.5 39.5 1.5 1.6 4.0 -3.0 1.6 20.0 -1.57
2 8 Pedestrian 0 0 0.10 49.5 9.5 54.5 29.5 1.8 0.5 0.8 2.0 1.6 15.0 0.10
"""


# https://motchallenge.net/instructions: frames and pixels from 1; class 3 = car, 1 = pedestrian
MOT = "1,7,10.5,20.5,20,20,1,3,1\n3,7,20.5,20.5,20,20,1,3,1\n3,8,50.5,10.5,5,20,1,1,1\n"


# https://docs.ultralytics.com/datasets/detect: class, centre and size as fractions of the image
# size
YOLO = {
    "data.yaml": "path: .\ntrain: images\nval: images\nnames: {0: person, 1: car}\n",
    "labels/a_000000.txt": "1 0.2 0.6 0.2 0.4\n",
    "labels/a_000001.txt": "",
    "labels/a_000002.txt": "1 0.3 0.6 0.2 0.4\n0 0.525 0.4 0.05 0.4\n",
}

FILES = {"coco": COCO, "cvat": CVAT, "kitti": KITTI, "mot": MOT}


def make(folder: Path, name: str) -> Path:
    """The reference file or folder of a format; its name does not depend on the format."""
    path = folder / "labels.dat"
    if name == "yolo":
        for file, text in YOLO.items():
            (path / file).parent.mkdir(parents=True, exist_ok=True)
            (path / file).write_text(text)
    else:
        path.write_text(FILES[name])
    return path
