"""Titles of the label formats for help pages, without imports; a test compares them with
`LABEL_FORMATS`.
"""

GENERAL_TITLES = (  # of those that are read as ground truth of a run, too
    "COCO, CVAT for video 1.1, YOLO, a tracks.parquet, ASAM OpenLABEL, CreateML, BDD100K, LabelMe, Label Studio, "
    "VIA, Supervisely, supervision, CSV of Roboflow, CSV of VIA, Pascal VOC, UA-DETRAC"
)
TRUTH_TITLES = "MOTChallenge, KITTI, a CSV of labels, " + GENERAL_TITLES.replace(
    "a tracks.parquet, ",
    "",  # the rows of a run are no ground truth
)
TRUTH_NAMES = (
    "mot, kitti, csv, coco, cvat, yolo, openlabel, createml, bdd100k, labelme, labelstudio, via, supervisely, "
    "supervision, csv_filename, via_csv, voc, detrac"
)
READ_TITLES = f"MOTChallenge, KITTI, a tracks.csv, a CSV of labels, {GENERAL_TITLES}"
