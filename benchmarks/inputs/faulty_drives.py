"""Drives with wrong inputs: every fault of scale, image size, time, pairing, cameras and speeds.

A fault is a change of the images, the boxes, the calibration, the speed or the stated frame rate of
a drive. `shown` and `moment` keep the truth of changed sequences: image k shows frame `shown[k]` of
the drive, and is taken to be of frame `moment[k]`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from benchmarks.inputs.drives import REAL_DATA, decoded
from track_range.foundation.arrays import FloatArray, Image

FPS = 10.0
FROZEN_S = 2.0  # time for which both cameras repeat an image

Images = list[Image]


@dataclass(frozen=True, slots=True)
class Drive:
    """A pair of recordings; `known` are options of runs that make its scale known."""

    name: str
    left: Images
    right: Images
    rig: dict[str, list[float]]  # KITTI's P2 and P3 (12,)
    truth: str  # file of the labels
    known: dict[str, Any]
    boxes: str | None = None  # recorded ones, KITTI's lines; None = those of the packaged detector
    speed: FloatArray | None = None  # (T, 2) time and speed of the ego vehicle; None = unknown
    true_mps: FloatArray | None = None  # (F,) speed in each frame of the drive
    shown: tuple[int, ...] = ()  # frame of the drive that each image shows; () = its own
    moment: tuple[int, ...] = ()  # frame of the drive at the time of each image; () = its own
    # (F, 2, 3) maps from left pixels of the drive to those of the images; None = the same
    left_map: FloatArray | None = None
    box_scale: float = 1.0  # sides of recorded boxes relative to those of the drive
    fps: float = FPS  # stated frame rate

    @property
    def n_frames(self) -> int:
        """Number of the images of each camera."""
        return len(self.left)

    def source(self, frame: int) -> tuple[int, int]:
        """Frames of the drive that image `frame` shows, and of whose time it is taken to be."""
        own = (frame, frame)
        shown = self.shown[frame] if self.shown else own[0]
        return shown, self.moment[frame] if self.moment else own[1]


Change = Callable[[Drive, int], Drive]  # the second argument is the frame from which it holds


@dataclass(frozen=True, slots=True)
class Fault:
    """A wrong input."""

    section: str  # of the list of faults: scale, size, time, pair, rig, clock, speed or image
    name: str
    change: Change
    said: str  # pattern of the notes that notice it
    cause: str  # pattern of the notes that name the right cause
    is_mono: bool = False
    is_known: bool = False  # whether runs have `Drive.known`
    is_sudden: bool = False  # whether it begins during the drive
    after_s: float = 0.0  # errors count from this time after its beginning
    for_s: float = math.inf  # and for this time

    def applies_to(self, drive: Drive) -> bool:
        """Whether the drive has the input that is wrong."""
        if self.name.startswith("boxes"):
            return drive.boxes is not None
        needs_speed = self.is_known and self.section in ("values", "clock", "speed")
        return drive.speed is not None or not needs_speed


# ------------------------------------------------------------------------------------ calibration


def baseline(factor: float) -> Change:
    """A baseline that is stated `factor` times too long."""

    def change(drive: Drive, _: int) -> Drive:
        left, right = drive.rig["P2"], list(drive.rig["P3"])
        right[3] = left[3] - factor * (left[3] - right[3])
        return replace(drive, rig={"P2": left, "P3": right})

    return change


def focal(factor: float) -> Change:
    """Focal lengths that are stated `factor` times too long; the baseline is unchanged."""
    return _projections((0, 3, 5), lambda value: factor * value)


def principal(offset_px: float) -> Change:
    """A principal point that is stated too far to the right."""
    return _projections((2,), lambda value: value + offset_px)


def _projections(entries: tuple[int, ...], stated: Callable[[float], float]) -> Change:
    def change(drive: Drive, _: int) -> Drive:
        rig = {
            name: [stated(value) if i in entries else value for i, value in enumerate(P)]
            for name, P in drive.rig.items()
        }
        return replace(drive, rig=rig)

    return change


# ----------------------------------------------------------------------------------------- images


def _affine(image: Image, matrix: FloatArray) -> Image:
    size_px = image.shape[1::-1]
    return np.asarray(
        cv2.warpAffine(image, matrix, size_px, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def each(
    left: Callable[[Image], Image] | None, right: Callable[[Image], Image] | None
) -> Callable[..., Drive]:
    """All images of a camera changed; None = unchanged."""

    def change(drive: Drive, _: int) -> Drive:
        return replace(
            drive,
            left=[left(image) for image in drive.left] if left else drive.left,
            right=[right(image) for image in drive.right] if right else drive.right,
        )

    return change


def shifted(x_px: float, y_px: float) -> Callable[[Image], Image]:
    """Images that are moved to the right and down, black where nothing was."""
    matrix = np.array([[1, 0, x_px], [0, 1, y_px]], np.float64)
    return lambda image: np.asarray(cv2.warpAffine(image, matrix, image.shape[1::-1]), np.uint8)


def flipped(code: int) -> Callable[[Image], Image]:
    """Mirrored images (cv2.flip)."""
    return lambda image: np.asarray(cv2.flip(image, code), np.uint8)


def resized(x: float, y: float) -> Callable[..., Drive]:
    """Images of another size than the rig's."""
    return each(*[lambda image: np.asarray(cv2.resize(image, None, fx=x, fy=y), np.uint8)] * 2)


def yaw(degrees: float, *, is_sudden: bool = False, is_slow: bool = False) -> Change:
    """A right camera that is turned: from the start, suddenly, or slowly until the end."""

    def change(drive: Drive, frame: int) -> Drive:
        n = len(drive.right)
        fraction = np.ones(n)
        if is_sudden:
            fraction = np.where(np.arange(n) >= frame, 1.0, 0.0)
        if is_slow:
            fraction = np.clip((np.arange(n) - frame) / max(n - 1 - frame, 1), 0, 1)
        K = np.reshape(drive.rig["P3"], (3, 4))[:, :3]
        right = [
            _turned(image, K, degrees * part) if part > 0 else image
            for image, part in zip(drive.right, fraction.tolist(), strict=True)
        ]
        return replace(drive, right=right)

    return change


def _turned(image: Image, K: FloatArray, degrees: float) -> Image:
    H = K @ cv2.Rodrigues(np.radians([0.0, degrees, 0.0]))[0] @ np.linalg.inv(K)
    return np.asarray(cv2.warpPerspective(image, H, image.shape[1::-1]), np.uint8)


def zoom(left: float, right: float) -> Change:
    """Focal lengths that change during the drive, as of lenses that focus or are warm."""
    return _moved_images(_zoom_map(left), _zoom_map(right))


def _zoom_map(factor: float) -> Callable[[Drive, int], FloatArray]:
    def at(drive: Drive, _: int) -> FloatArray:
        cx_px, cy_px = drive.rig["P2"][2], drive.rig["P2"][6]
        return np.array([[factor, 0, cx_px * (1 - factor)], [0, factor, cy_px * (1 - factor)]])

    return at


def right_moved(x_px: float) -> Change:
    """A right camera whose image moves sideways during the drive."""
    return _moved_images(None, lambda _, __: np.array([[1, 0, x_px], [0, 1, 0.0]]))


def jitter(sigma_px: float) -> Change:
    """Images of both cameras that jump by the same random offsets, as of a mount that vibrates."""

    def change(drive: Drive, _: int) -> Drive:
        offsets_px = np.random.default_rng(3).normal(0, sigma_px, (drive.n_frames, 2))

        def at(_: Drive, frame: int) -> FloatArray:
            x_px, y_px = offsets_px[frame].tolist()
            return np.array([[1, 0, x_px], [0, 1, y_px]])

        return _moved_images(at, at)(drive, 0)

    return change


def _moved_images(
    left: Callable[[Drive, int], FloatArray] | None,
    right: Callable[[Drive, int], FloatArray] | None,
) -> Change:
    """Images that are mapped by (2, 3) matrices of their frame, from the frame of the fault on."""

    def change(drive: Drive, frame: int) -> Drive:
        sides = []
        for images, matrix_at in ((drive.left, left), (drive.right, right)):
            matrices = [
                np.eye(2, 3) if matrix_at is None or k < frame else matrix_at(drive, k)
                for k in range(len(images))
            ]
            moved = [
                _affine(image, matrix) if (matrix != np.eye(2, 3)).any() else image
                for image, matrix in zip(images, matrices, strict=True)
            ]
            sides.append((moved, np.array(matrices)))
        return replace(drive, left=sides[0][0], right=sides[1][0], left_map=sides[0][1])

    return change


def boxes(factor: float) -> Change:
    """Boxes of a detector whose sides are all `factor` times too long."""
    return lambda drive, _: replace(drive, box_scale=factor)


def unrelated(drive: Drive, _: int) -> Drive:
    """The right images are those of another drive."""
    other = decoded(
        REAL_DATA / "kitti_stereo" / ("0005" if drive.name == "0003" else "0003") / "right.mp4"
    )
    size_px = drive.left[0].shape[1::-1]
    images = [np.asarray(cv2.resize(image, size_px), np.uint8) for image in other]
    return replace(drive, right=[images[k % len(images)] for k in range(len(drive.left))])


# ------------------------------------------------------------------------------------------- time


def order(of_right: Callable[[int, int], list[int]]) -> Change:
    """The right images in another order: a function of their number and the frame of the fault."""

    def change(drive: Drive, frame: int) -> Drive:
        right = [drive.right[k] for k in of_right(len(drive.right), frame)]
        n = min(len(drive.left), len(right))
        return replace(drive, left=drive.left[:n], right=right[:n])

    return change


def skipped(k: int) -> Change:
    """`k` right images dropped; -k: an image repeated k times."""
    return order(lambda n, at: [*range(at), *[at] * max(-k, 0), *range(at + max(k, 0), n)])


def frozen(drive: Drive, frame: int) -> Drive:
    """Both cameras repeat an image for `FROZEN_S`, while time passes."""
    n, until = drive.n_frames, frame + round(FROZEN_S * FPS)
    shown = [frame if frame <= k < until else k for k in range(n)]
    return _sequence(drive, shown, list(range(n)))


def doubled(drive: Drive, _: int) -> Drive:
    """Every fifth image twice, as when 25 frames/s are written as 30 frames/s."""
    shown = [k for k in range(drive.n_frames) for _ in range(2 if k % 5 == 4 else 1)]
    return replace(_sequence(drive, shown, shown), fps=1.2 * FPS)


def _sequence(drive: Drive, shown: Sequence[int], moment: Sequence[int]) -> Drive:
    return replace(
        drive,
        left=[drive.left[k] for k in shown],
        right=[drive.right[k] for k in shown],
        shown=tuple(shown),
        moment=tuple(moment),
    )


def stated_fps(fps: float) -> Change:
    """Another frame rate than that of the cameras."""
    return lambda drive, _: replace(drive, fps=fps)


def speed(factor: float = 1.0, late_s: float = 0.0) -> Change:
    """Given speeds times a factor, which come too late."""

    def change(drive: Drive, _: int) -> Drive:
        if drive.speed is None:
            raise ValueError(f"{drive.name}: expected a drive with a known speed")
        time_s, mps = drive.speed.T
        return replace(
            drive, speed=np.stack([time_s, factor * np.interp(time_s - late_s, time_s, mps)], 1)
        )

    return change


# ------------------------------------------------------------------------------------------ table

SCALE, SIZE = "Scale in doubt", "focal length is in doubt|principal point in the middle third"
TIME = "not synchronised|repeats its last image|do not show the same moment"
PAIR = f"{TIME}|swapped|rig does not fit|upside down|ertical offset"
# words of any doubt; notes that runs without the fault have, too, do not count, and those of an
# alignment always say by how much disparities are too small, and those of an agreement a factor
ANY = (
    rf"^(?!Alignment: )(?!.*no contradiction).*(?:{SCALE}|{SIZE}|{PAIR}|(?:camera|rig|pair) (?:has )?moved|is turned"
    r"|repeat|\b(?:froze|frozen|identical|vibrate|shake|jump|zoomed)\b|\b(?:s|seconds) late\b"
    r"|contradicts|do(?:es)? not (?:fit|change)|given speed is below|times what"
    r"|focal length (?:of both cameras )?changed|principal point is)"
)
_MOVED = r"right camera (?:has )?moved|right camera is turned"


def _of_issue(section: str, name: str, change: Change, cause: str, **others: Any) -> Fault:
    return Fault(section, name, change, ANY, cause, after_s=others.pop("after_s", 2.0), **others)


FAULTS = (
    *(
        Fault(
            "scale",
            f"baseline {f:g}",
            baseline(f),
            SCALE,
            "baseline",
            is_known=f in (0.83, 1.2),
            after_s=2.0,
        )
        for f in (0.39, 0.5, 0.67, 0.83, 1.2, 1.5, 2.54, 4.3, 9.0)
    ),
    *(
        Fault(
            "scale",
            f"focal length {f:g}, one camera",
            focal(f),
            SCALE,
            "focal length",
            is_mono=True,
            is_known=True,
            after_s=2.0,
        )
        for f in (0.5, 2.0)
    ),
    *(
        Fault("size", f"images {x:g} x {y:g}", resized(x, y), SIZE, "principal point")
        for x, y in ((0.75, 0.75), (0.5, 0.5), (1024 / 1242, 320 / 375))
    ),
    *(
        Fault("time", f"{k} dropped", skipped(k), TIME, "left video lags", is_sudden=True)
        for k in (1, 3)
    ),
    *(
        Fault(
            "time", f"{k} repeated", skipped(-k), TIME, "right video (repeats|lags)", is_sudden=True
        )
        for k in (1, 5)
    ),
    Fault(
        "time",
        "frozen",
        order(lambda n, at: [*range(at), *[at] * (n - at)]),
        TIME,
        "right video repeats",
        is_sudden=True,
    ),
    Fault(
        "time",
        "lag 2 from the start",
        order(lambda n, at: [0, 0, *range(n - 2)]),
        TIME,
        "right video lags",
    ),
    Fault("pair", "swapped", lambda d, _: replace(d, left=d.right, right=d.left), PAIR, "swapped"),
    *(
        Fault(
            "pair",
            f"offset {x:+d} px",
            each(None, shifted(-x, 0)),
            f"{PAIR}|px too",
            "disparities|camera is turned",
        )
        for x in (-60, -15, 15, 60)
    ),
    *(
        Fault("pair", f"yaw {a:+d} degrees", yaw(a), f"{PAIR}|px too", "disparities|turned")
        for a in (-3, -1, 1, 3)
    ),
    Fault("pair", "rows 20 px", each(None, shifted(0, 20)), PAIR, "ertical|rows"),
    Fault("pair", "both upside down", each(flipped(-1), flipped(-1)), PAIR, "upside down"),
    Fault("pair", "right upside down", each(None, flipped(-1)), PAIR, "upside down"),
    Fault("pair", "right mirrored", each(None, flipped(1)), PAIR, "mirrored"),
    Fault("pair", "same video twice", lambda d, _: replace(d, right=d.left), PAIR, "one camera"),
    Fault("pair", "unrelated videos", unrelated, PAIR, "different scenes"),
    *(
        _of_issue(
            "values",
            f"baseline {f:g}{', speed given' if known else ''}",
            baseline(f),
            "baseline",
            is_known=known,
        )
        for f in (0.8, 1.25)
        for known in (False, True)
    ),
    *(
        _of_issue(
            "values",
            f"focal length {f:g}{', speed given' if known else ''}",
            focal(f),
            "focal length",
            is_known=known,
        )
        for f, known in ((1.15, False), (0.8, True), (1.25, True))
    ),
    *(
        _of_issue(
            "values",
            f"focal length {f:g}, one camera{', speed given' if known else ''}",
            focal(f),
            "focal length",
            is_mono=True,
            is_known=known,
        )
        for f, known in ((1.25, False), (0.8, True), (1.25, True))
    ),
    _of_issue("values", "principal point +62 px", principal(62), "principal point"),
    _of_issue(
        "values",
        "principal point +62 px, one camera",
        principal(62),
        "principal point",
        is_mono=True,
    ),
    _of_issue("rig", "right hit, yaw 0.3", yaw(0.3, is_sudden=True), _MOVED, is_sudden=True),
    _of_issue("rig", "slow yaw 0.3", yaw(0.3, is_slow=True), f"{_MOVED}|drift", is_sudden=True),
    _of_issue("rig", "zoom 1 % right", zoom(1, 1.01), "its focal length|zoom", is_sudden=True),
    _of_issue("rig", "zoom 3 % both", zoom(1.03, 1.03), "focal length|zoom", is_sudden=True),
    _of_issue("rig", "right moved 1.5 px", right_moved(1.5), _MOVED, is_sudden=True),
    _of_issue(
        "clock",
        "both frozen 2 s",
        frozen,
        "repeat|do not change",
        is_sudden=True,
        after_s=0.3,
        for_s=FROZEN_S - 0.3,
    ),
    *(
        _of_issue(
            "clock",
            f"frame rate 20{', speed given' if known else ''}",
            stated_fps(2 * FPS),
            "frame rate",
            is_known=known,
        )
        for known in (False, True)
    ),
    _of_issue("clock", "every fifth doubled", doubled, "repeat|doubl|identical"),
    _of_issue("speed", "zeros", speed(0.0), "given speed|the speed is", is_known=True),
    *(
        _of_issue("speed", f"{t} s late", speed(late_s=t), r"\bs late\b", is_known=True)
        for t in (1, 2)
    ),
    *(
        _of_issue("speed", f"{f:g} times", speed(f), "given speed|the speed is", is_known=True)
        for f in (1.15, 1.6)
    ),
    *(_of_issue("image", f"jitter {s:g} px", jitter(s), "vibrate|shake") for s in (1.5, 4)),
    *(
        _of_issue(
            "image",
            f"boxes 0.9{', one camera' if mono else ''}",
            boxes(0.9),
            "boxes|the sizes? (?:are|is)",
            is_mono=mono,
        )
        for mono in (False, True)
    ),
)


def clean(fault: Fault) -> Fault:
    """No fault, in a run with the options of another fault's runs."""
    name = (
        f"none{', speed given' if fault.is_known else ''}{', one camera' if fault.is_mono else ''}"
    )
    return Fault(
        "",
        name,
        lambda drive, _: drive,
        ANY,
        "",
        is_mono=fault.is_mono,
        is_known=fault.is_known,
        after_s=2.0,
    )
