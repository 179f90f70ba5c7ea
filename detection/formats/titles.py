"""Titles of the label formats for help pages, without imports; a test compares them with
`LABEL_FORMATS`.
"""

GENERAL_TITLES = (  # of those that are read as ground truth of a run, too
    "COCO, CVAT for video 1.1, YOLO, a tracks.parquet, CreateML, BDD100K, LabelMe, Label Studio, "
    "VIA, Supervisely, supervision, CSV of Roboflow, CSV of VIA, Pascal VOC, UA-DETRAC"
)
READ_TITLES = f"MOTChallenge, KITTI, a tracks.csv, a CSV of labels, {GENERAL_TITLES}"
