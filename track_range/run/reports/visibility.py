"""Visibility: whether images are like those on which the packaged detector was measured.

Of every tenth frame, three figures of a sample of pixels are compared with limits within which the
detector finds at least 85 % of what it finds in daylight (`python -m benchmarks visibility`):

    brightness   mean of the grey levels, 0 to 255
    contrast     their standard deviation
    sharpness    root mean square difference of neighbours, relative to that of pixels eight times as far apart
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import Note
from track_range.pipeline.frame_result import FrameResult
from track_range.run.reports.report import Reports
from track_range.stereo.geometry.frames import ImageView

_INTERVAL = 10  # frames between two that are measured
_STEP_PX = 8  # between the pixels that are averaged
# width of the images in which neighbours are compared, of the input of the packaged detector, and
# distance of those that are far apart
_WIDTH_PX, _FAR = 640, 8
# limits within which the detector finds at least 85 % of what it finds in daylight, and the brightness
# below which a low contrast is darkness, and not fog; see the table of docs/concepts/accuracy.md
_BRIGHTNESS, _LEAST_CONTRAST, _LEAST_SHARPNESS, _SHADE = (30.0, 205.0), 22.0, 0.25, 80.0
_WORDS = {
    "dark": "dark",
    "bright": "overexposed",
    "flat": "of low contrast (fog, glare or a dirty windscreen)",
    "blurred": "blurred (focus, dirt or drops on the lens)",
}
# fraction of a run from which on it is said before anything else, and least one that is a note
_MOSTLY, _NOTED = 0.2, 0.02
_MOST_SPANS = 20  # in the summary


@dataclass(frozen=True, slots=True)
class Look:
    """What an image looks like."""

    brightness: float
    contrast: float
    sharpness: float

    def faults(self) -> tuple[str, ...]:
        """In which of `_WORDS` it is unlike the images that were measured."""
        is_flat, is_shade = self.contrast < _LEAST_CONTRAST, self.brightness < _SHADE
        has_fault = {
            "dark": self.brightness < _BRIGHTNESS[0] or (is_flat and is_shade),
            "bright": self.brightness > _BRIGHTNESS[1],
            "flat": is_flat and not is_shade,
            "blurred": self.sharpness < _LEAST_SHARPNESS,
        }
        return tuple(name for name, is_one in has_fault.items() if is_one)


def look_of(image: ImageView) -> Look:
    """The look of an image, (H, W) or (H, W, 3) BGR."""
    near = max(1, round(image.shape[1] / _WIDTH_PX))
    margin = near * _FAR

    def at(down_px: int, right_px: int) -> FloatArray:
        height, width = image.shape[0] - margin, image.shape[1] - margin
        part = image[down_px : height + down_px, right_px : width + right_px]
        sample = np.asarray(part[::_STEP_PX, ::_STEP_PX], np.float64)
        return sample if sample.ndim == 2 else sample[:, :, 1]

    def difference(px: int) -> float:
        squares = (at(px, 0) - middle) ** 2 + (at(0, px) - middle) ** 2
        return float(np.sqrt(squares.mean() / 2))

    middle = at(0, 0)
    if not middle.size:
        return Look(np.nan, np.nan, np.nan)
    far = difference(margin)
    sharpness = difference(near) / far if far > 0 else np.nan
    return Look(float(middle.mean()), float(middle.std()), sharpness)


class Visibility(Reports):
    """The visibility in the frames of a run, which are passed in order."""

    def __init__(self, n_latest: int | None = None) -> None:
        """`n_latest` images are kept of a drive without an end; None = all of a video."""
        self._n_frames = 0
        self._of = "the video" if n_latest is None else "the latest frames"
        self._times_s: deque[float] = deque(maxlen=n_latest)
        self._looks: deque[Look] = deque(maxlen=n_latest)

    def add(self, result: FrameResult) -> None:
        """Add a frame."""
        if self._n_frames % _INTERVAL == 0:
            self._times_s.append(result.time_s)
            self._looks.append(look_of(result.left))
        self._n_frames += 1

    def notes(self) -> Sequence[str]:
        """A note on images that are unlike those that were measured."""
        section = self.summary().get("visibility", {})
        if not section.get("sentence"):
            return ()
        sentence = f"{section['sentence'].rstrip('.')} ({section['figures']})."
        return (Note(sentence, "low-visibility", "warning", "left"),)

    def summary(self) -> Mapping[str, Any]:
        """Section `visibility`: medians, the fraction of the frames outside of what was measured, in
        all and by fault, and when; the sentence of a note, and whether it comes first.
        """
        if not self._looks:
            return {}
        faults = [look.faults() for look in self._looks]
        is_outside = [bool(names) for names in faults]
        section: dict[str, Any] = {
            **_medians(self._looks),
            "outside": _share(is_outside),
            **{name: _share([name in names for names in faults]) for name in _WORDS},
            "spans_s": self._spans(is_outside),
        }
        section |= {"sentence": "", "figures": "", "is_low": section["outside"] >= _MOSTLY}
        if section["outside"] >= _NOTED:
            seen = [look for look, is_one in zip(self._looks, is_outside, strict=True) if is_one]
            section |= {
                "sentence": low_visibility(section, self._of),
                "figures": _figures(_medians(seen)),
            }
        return {"visibility": {**section, "spans_s": section["spans_s"][:_MOST_SPANS]}}

    def _spans(self, is_outside: Sequence[bool]) -> list[list[float]]:
        """First and last times of the stretches of measured frames that are outside."""
        edges = np.flatnonzero(np.diff([False, *is_outside, False]))
        times_s = np.round(self._times_s, 3)
        return [
            [float(times_s[first]), float(times_s[end - 1])]
            for first, end in zip(edges[::2], edges[1::2], strict=True)
        ]


def _medians(looks: Sequence[Look]) -> dict[str, float | None]:
    """Median of each figure; None = unknown, as the sharpness of black images."""
    medians = {}
    for figure in ("brightness", "contrast", "sharpness"):
        values = np.array([getattr(look, figure) for look in looks])
        known = values[np.isfinite(values)]
        medians[figure] = round(float(np.median(known)), 3) if len(known) else None
    return medians


def _share(flags: Sequence[bool]) -> float:
    return round(float(np.mean(flags)), 3)


def low_visibility(section: Mapping[str, Any], of: str) -> str:
    """Sentence on the section `visibility` of images that are partly outside of what was measured;
    `of` names them.
    """
    names = sorted((name for name in _WORDS if section[name] > 0), key=lambda name: -section[name])
    shown = " and ".join(_WORDS[name] for name in names[:2])
    first, last = section["spans_s"][0][0], section["spans_s"][-1][1]
    return (
        f"The images are {shown} in {100 * section['outside']:.0f} % of {of}, from {first:.1f} "
        f"to {last:.1f} s: road users are missed there, and what is not reported may have happened."
    )


def _figures(medians: Mapping[str, float | None]) -> str:
    """The medians of the part that is outside of what was measured, with the limits."""
    low, high = _BRIGHTNESS
    sharpness = medians["sharpness"]
    figures = f"brightness {medians['brightness']:.0f}, contrast {medians['contrast']:.0f}"
    figures += "" if sharpness is None else f", sharpness {sharpness:.2f}"
    return (
        f"medians there: {figures}; detection was measured at {low:.0f} to {high:.0f}, from "
        f"{_LEAST_CONTRAST:.0f} and from {_LEAST_SHARPNESS:g}"
    )
