"""Kinds of JSON files that are no COCO data sets are named."""

from pathlib import Path

import pytest

from track_range.detection.formats.tables.box_table import NO_FACTS
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.video_labels.coco import read_coco


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[]", "found a list"),
        ("[1, 2]", "found a list"),
        (
            '[{"image_id": 1, "category_id": 2, "bbox": [0, 0, 1, 1]}]',
            "a list of detection results",
        ),
        ('{"items": [], "categories": {}}', "a data set of Datumaro"),
    ],
)
def test_other_json(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "labels.json"
    path.write_text(text)
    with pytest.raises(LabelFileError, match=words):
        read_coco(path, NO_FACTS)
