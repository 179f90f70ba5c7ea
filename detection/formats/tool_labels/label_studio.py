"""The boxes in files of Label Studio: JSON, JSON-MIN and video labels, in per cent of the image.

https://labelstud.io/guide/export
"""

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

from track_range.detection.formats.tables.limits import MAX_FRAME
from track_range.detection.formats.tool_labels.tool import Object

_SIDES = ("x", "y", "width", "height")
# that Label Studio puts before the names of uploaded images
_UPLOADED = re.compile(r"^[0-9a-f]{8}-")


def boxes_of_tasks(content: Any) -> Iterator[Object]:
    """The boxes of each task: `value` of a `result`, and `data` of the task.

    Boxes of a track in a video have its `number` and a `frame`, others the name of the `image`.
    """
    for task in content if isinstance(content, list) else [content]:
        data = task.get("data", task)
        for number, result in enumerate(_results(task)):
            value = result["value"]
            item = {"data": data, "result": result, "value": value, "video": data.get("video")}
            if "sequence" in value:
                yield from _track(item | {"number": number, "label": value["labels"][0]})
            elif labels := value.get("rectanglelabels"):
                yield item | {"image": _image_name(data), "label": labels[0]}
            elif kind := result.get("type"):
                yield item | {"image": _image_name(data), "label": kind, "no_box": kind}


def _results(task: Object) -> Sequence[Any]:
    """The results of a task's first annotation that was not cancelled, else of its predictions; or
    its boxes in the short JSON.
    """
    done = [done for done in task.get("annotations") or () if not done.get("was_cancelled")]
    if done or task.get("predictions"):
        results: Sequence[Any] = (done or task["predictions"])[0]["result"]
        return results
    return [{"value": value} for key in ("label", "bbox", "box") for value in task.get(key) or ()]


def _image_name(data: Object) -> str:
    """The name of a task's image, without the address and Label Studio's prefix of uploads."""
    texts = (data.get(key) for key in ("image", "img", "ocr"))
    name = next(text for text in texts if isinstance(text, str))
    return _UPLOADED.sub("", name.partition("?")[0].rpartition("/")[2])


def _track(item: Object) -> Iterator[Object]:
    """The boxes of a track in a video, including boxes interpolated between two keyframes.

    The last box remains until the end of the video, unless the track is switched off.
    """
    value = item["value"]
    keys = sorted(value["sequence"], key=lambda key: int(key["frame"]))
    n_frames = int(value.get("framesCount") or 0)
    for key, after in pairwise([*keys, None]):
        start = int(key["frame"])
        end = start + 1
        if key.get("enabled", True):
            end = max(end, n_frames + 1) if after is None else int(after["frame"])
        if end - start > MAX_FRAME:
            raise ValueError("frames")
        target = after or key
        for frame in range(start, end):
            fraction = (frame - start) / (end - start)
            box = {s: float(key[s]) + (float(target[s]) - float(key[s])) * fraction for s in _SIDES}
            value = {**value, **box, "rotation": key.get("rotation")}
            yield {**item, "frame": frame, "value": value}
