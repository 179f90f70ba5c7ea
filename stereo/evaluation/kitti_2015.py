"""KITTI's stereo data set of 2015: stereo pairs with the true disparities of labelled cars.

    FOLDER/image_2/NAME.png     left image      FOLDER/disp_occ_0/NAME.png  true disparity * 256, 16 bit, 0 = unknown
    FOLDER/image_3/NAME.png     right image     FOLDER/obj_map/NAME.png     number of the car, 0 = none
    FOLDER/calib.txt for all pairs, or FOLDER/calib_cam_to_cam/NUMBER.txt for each, or a rig file given by the user

The box of an instance is the bounding box of its pixels, its truth the median of the true disparities in the inner half
of the box. (Menze & Geiger, "Object scene flow for autonomous vehicles", CVPR 2015.)
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.foundation.errors import UserError
from track_range.foundation.files.images import read_image
from track_range.stereo.geometry.frames import ImageView
from track_range.stereo.geometry.rectification import Rectifier
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.matching.sgbm import inner_halves
from track_range.stereo.rig_formats.reading import load_rig

# the four folders of a set
LEFT, RIGHT, TRUTH, INSTANCES = "image_2", "image_3", "disp_occ_0", "obj_map"
MIN_TRUE_PIXELS = 100  # minimum number of pixels with known disparity of an instance
MIN_INNER_PIXELS = 20  # the same in the inner half of its box
LABELLED_CLASS = "car"  # road class of all labelled objects of the set
# Files of `track-range simulate --disparity`, which writes objects of all classes in the set's
# layout.
_SIMULATED_RIG, _SIMULATED_TRUTH = "rig.yaml", "truth.csv"
_STEPS_PER_PX = 256.0  # steps of the stored disparities per pixel


class PairFileError(UserError):
    """A set of stereo pairs that cannot be used; the message names the file."""


@dataclass(frozen=True, slots=True)
class StereoPair:
    """One pair of a set with N labelled objects."""

    name: str  # name of the files, without .png
    left: Image  # (H, W, 3) uint8 BGR, rectified
    right: ImageView  # rectified right image, possibly grey and computed only where it is read
    xyxy_px: FloatArray  # (N, 4) boxes in the left image
    true_px: FloatArray  # (N,) true disparity of the inner half of each box
    rig: StereoRig  # the rectified rig
    notes: tuple[str, ...] = ()  # messages for the user about the rig
    # (N,) identities of the objects over the frames of a drive; (0,) for unrelated pairs
    track_id: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    class_names: tuple[str, ...] = ()  # N road classes ("car", "person", ...); () = unknown

    @property
    def x_px(self) -> FloatArray:
        """(N,) column of the centre of each box."""
        return np.asarray((self.xyxy_px[:, 0] + self.xyxy_px[:, 2]) / 2)


def is_kitti_2015(folder: Path) -> bool:
    """Whether a folder, or its `training`, contains the set's left images or true disparities."""
    return any((_root(folder) / part).is_dir() for part in (LEFT, TRUTH))


def pair_names(folder: Path) -> list[str]:
    """Names of the pairs with true disparities, in order.

    Raises PairFileError if the folder or one of its four parts is missing, or there are no true
    disparities.
    """
    if not folder.is_dir():
        raise PairFileError(
            f"{folder}: no such folder; give one with {LEFT}, {RIGHT}, {TRUTH} and {INSTANCES}."
        )
    root = _root(folder)
    missing = [part for part in (LEFT, RIGHT, TRUTH, INSTANCES) if not (root / part).is_dir()]
    if missing:
        raise PairFileError(
            f"{folder}: expected KITTI 2015's folders {LEFT} (left images), {RIGHT} (right "
            f"images), {TRUTH} (true disparities) and {INSTANCES} (cars), found no "
            f"{' and no '.join(missing)}."
        )
    names = sorted(path.stem for path in (root / TRUTH).glob("*.png"))
    if not names:
        raise PairFileError(f"{root / TRUTH}: expected true disparities (*.png), found none.")
    return names


def read_pairs(
    folder: Path, *, rig: Path | None = None, row_offset_px: float = 0.0
) -> Iterator[StereoPair]:
    """The pairs of a set, or of the set `training` in a folder, by name, read one by one.

    `rig` is a rig file of a rectified pair, None = the calibration of the set; `row_offset_px` the
    vertical offset y_right - y_left, which is removed from the right images. Raises PairFileError
    if a part or an image is missing, damaged, or of another size, and RigError if the calibration
    is missing, or cannot be used.
    """
    for name in pair_names(folder):
        yield read_pair(folder, name, rig=rig, row_offset_px=row_offset_px)


def read_pair(
    folder: Path, name: str, *, rig: Path | None = None, row_offset_px: float = 0.0
) -> StereoPair:
    """One pair of a set; see `read_pairs`."""
    root = _root(folder)
    left, right, truth, instance = (
        _read(root / part / f"{name}.png") for part in (LEFT, RIGHT, TRUTH, INSTANCES)
    )
    for part, image in ((RIGHT, right), (TRUTH, truth), (INSTANCES, instance)):
        if image.shape[:2] != left.shape[:2]:
            raise PairFileError(
                f"{root / part / name}.png: expected the size of the left image, {_size(left)} px, "
                f"found {_size(image)} px."
            )
    if truth.ndim != 2 or truth.dtype != np.uint16:
        raise PairFileError(
            f"{root / TRUTH / name}.png: expected 16-bit grey values (256 times the disparity)."
        )
    if instance.ndim != 2:
        raise PairFileError(
            f"{root / INSTANCES / name}.png: expected grey values (the number of the car at each "
            "pixel), found colour."
        )
    file = rig or _calibration(root, name)
    cameras, notes = load_rig(file, size_px=(left.shape[1], left.shape[0]))
    if not cameras.is_rectified:
        raise RigError(
            f"{file}: expected a rectified rig for the rectified images of the set; give their rig."
        )
    boxes, true_px = labelled_instances(truth / _STEPS_PER_PX, instance)
    rectifier = Rectifier(cameras, row_offset_px=row_offset_px, source=file)
    images = rectifier.rectify(_in_colour(left), _in_colour(right))
    class_names = () if (root / _SIMULATED_TRUTH).is_file() else (LABELLED_CLASS,) * len(boxes)
    return StereoPair(name, *images, boxes, true_px, cameras, notes, class_names=class_names)


def labelled_instances(
    true_px: FloatArray, instance: npt.NDArray[np.integer]
) -> tuple[FloatArray, FloatArray]:
    """(N, 4) boxes and (N,) true disparities of the instances with enough known pixels.

    `true_px` (H, W) are true disparities, 0 = unknown; `instance` (H, W) the numbers of the
    objects, 0 = none.
    """
    boxes, medians_px = [], []
    for number in np.unique(instance[instance > 0]).tolist():
        mask = instance == number
        rows, columns = np.nonzero(mask)
        box = np.array(
            [columns.min() - 0.5, rows.min() - 0.5, columns.max() + 0.5, rows.max() + 0.5]
        )
        patch = next(inner_halves(box[None], (mask.shape[0], mask.shape[1])))
        known = mask & (true_px > 0)
        if patch is None or known.sum() < MIN_TRUE_PIXELS:
            continue
        values_px = true_px[patch.window][known[patch.window]]
        if len(values_px) >= MIN_INNER_PIXELS:
            boxes.append(box)
            medians_px.append(float(np.median(values_px)))
    return np.array(boxes).reshape(-1, 4), np.array(medians_px)


def _root(folder: Path) -> Path:
    inner = folder / "training"
    return inner if not (folder / LEFT).is_dir() and (inner / LEFT).is_dir() else folder


def _calibration(root: Path, name: str) -> Path:
    """The calibration file of the pair, else of the set."""
    of_pair = root / "calib_cam_to_cam" / f"{name.removesuffix('_10')}.txt"
    for file in (of_pair, root / "calib.txt", root / _SIMULATED_RIG):
        if file.is_file():
            return file
    raise RigError(
        f"{root}: expected calib.txt, {_SIMULATED_RIG} or {of_pair.parent.name}/{of_pair.name}, "
        "found none; give the rig with --rig FILE."
    )


def _read(path: Path) -> npt.NDArray[np.integer]:
    image = read_image(
        path, PairFileError, "one of the four images of a pair", flags=cv2.IMREAD_UNCHANGED
    )
    if image.dtype not in (np.uint8, np.uint16):
        raise PairFileError(
            f"{path}: expected pixels of 8 or 16 bits, found {image.dtype}; convert the image."
        )
    return image


def _in_colour(image: npt.NDArray[np.integer]) -> Image:
    """(H, W, 3) uint8 BGR of an image of any type."""
    eight = image if image.dtype == np.uint8 else image >> 8
    if eight.ndim == 2:
        return np.repeat(eight.astype(np.uint8)[:, :, None], 3, axis=2)
    return np.ascontiguousarray(eight[:, :, :3], np.uint8)


def _size(image: npt.NDArray[np.integer]) -> str:
    return f"{image.shape[1]}x{image.shape[0]}"
