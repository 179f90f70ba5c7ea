"""Search for the board in the images of a calibration: usable views, and the reasons why others are
rejected.

Rejected are unreadable images, images without a complete board, images of another size (a
difference of up to two pixels is cropped) and blurred images. Of many views in a video, the most
different ones are used.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from track_range.calibration.board_images import BoardImages, Shot
from track_range.foundation.arrays import Image
from track_range.foundation.files.input_files import counted
from track_range.stereo.calibration.board_views import (
    BoardFinder,
    BoardView,
    RejectedView,
    common_corners,
    count_board_sizes,
    count_markers,
)
from track_range.stereo.calibration.boards import Board, CalibrationError, CharucoBoard
from track_range.stereo.calibration.coverage import most_different

Advance = Callable[[int, int], None]
Views = tuple[BoardView, ...]
Size = tuple[int, int]
# largest number of views for a calibration; more cost time without improving accuracy
MAX_VIEWS = 60
# difference in size up to which images are from one camera, rounded or cropped by other software
_MAX_CROP_PX = 2
_BLURRED_PX = 4.0  # edge width, px, above which an image may be blurred; see `_BLURRED_RATIO`
# the same relative to the 25th percentile of all images; both must be exceeded
_BLURRED_RATIO = 2.5
# number of images from which the size of the board is determined if the given board is not found
_N_SAMPLES = 6


@dataclass(frozen=True, slots=True)
class BoardSearch:
    """Result of the search for a board."""

    shots: list[Views]  # the views of each usable shot, one per camera
    rejected: list[RejectedView]  # the rejected images
    notes: list[str]  # messages for the user
    n_images: int  # number of shots that were searched


def find_views(images: BoardImages, board: Board, advance: Advance) -> BoardSearch:
    """Search all images for the board; `advance` is called with the numbers of searched and of all
    shots.

    Raises CalibrationError for no board in any image, or a board of another size, and VideoError
    for a damaged video.
    """
    finder = BoardFinder(board)
    shots: list[Views] = []
    rejected = list(images.unpaired)
    samples: list[Image] = []
    n_images = 0
    for shot in images:
        n_images += 1
        advance(n_images, max(images.n_shots or 0, n_images))
        is_sample = not (n_images - 1) % max(1, (images.n_shots or 0) // _N_SAMPLES)
        if is_sample and len(samples) < _N_SAMPLES and shot.images[0] is not None:
            samples.append(shot.images[0])
        views = _views(finder, shot, is_video=images.is_video)
        if isinstance(views, RejectedView):
            rejected.append(views)
        else:
            shots.append(views)
    _check_board(board, samples, n_found=len(shots), n_images=n_images)
    shots, deviating, notes = _of_one_size(shots)
    shots, blurred = _sharp(shots)
    rejected += [*deviating, *blurred]
    if len(shots) > MAX_VIEWS:
        notes.append(f"{MAX_VIEWS} of {len(shots)} views are used, selected for variety.")
        shots = [shots[i] for i in most_different([shot[0] for shot in shots], MAX_VIEWS)]
    return BoardSearch(shots, rejected, notes, n_images)


def _views(finder: BoardFinder, shot: Shot, *, is_video: bool) -> Views | RejectedView:
    """The views of a shot, or its rejected image; a pair needs the board in both images."""
    views = []
    for name, image in zip(shot.names, shot.images, strict=True):
        if image is None:
            return RejectedView(name, "not an image, or damaged")
        if is_video and not finder.may_contain_board(image):
            return RejectedView(name, "no complete board found")
        view = finder.find(image, name)
        if isinstance(view, RejectedView):
            return view
        views.append(view)
    if len(views) == 1:
        return (views[0],)
    left, right = common_corners(views[0], views[1], finder.board)
    n_common = len(left.corner_id)
    return (
        (left, right)
        if n_common >= 6
        else RejectedView(left.name, f"only {n_common} corners seen by both cameras")
    )


def _of_one_size(shots: Sequence[Views]) -> tuple[list[Views], list[RejectedView], list[str]]:
    """The shots with images of the most common size per camera, the other images, and notes;
    differences of up to two pixels are cropped.
    """
    accepted: list[Views] = []
    rejected: list[RejectedView] = []
    cropped: list[str] = []
    common = [
        Counter(view.size_px for view in views).most_common(1)[0][0]
        for views in zip(*shots, strict=True)
    ]
    for shot in shots:
        deviating = [
            (view, size) for view, size in zip(shot, common, strict=True) if not _fits(view, size)
        ]
        if deviating:
            view, size = deviating[0]
            reason = f"{_text(view.size_px)} px, while most have {_text(size)} px"
            rejected.append(RejectedView(view.name, reason))
            continue
        for view, size in zip(shot, common, strict=True):
            if view.size_px != size:
                cropped.append(view.name)
        accepted.append(
            tuple(replace(view, size_px=size) for view, size in zip(shot, common, strict=True))
        )
    if not cropped:
        return accepted, rejected, []
    sizes = " and ".join(dict.fromkeys(map(_text, common)))
    note = f"Cropped to {sizes} px at the right and lower edges: {', '.join(cropped)}."
    return accepted, rejected, [note]


def _fits(view: BoardView, size_px: Size) -> bool:
    """Whether an image has this size, but for a crop."""
    width_px, height_px = view.size_px
    most = max(abs(width_px - size_px[0]), abs(height_px - size_px[1]))
    return most <= _MAX_CROP_PX


def _text(size: Size) -> str:
    return f"{size[0]}x{size[1]}"


def _sharp(shots: list[Views]) -> tuple[list[Views], list[RejectedView]]:
    """The shots that are not blurred, and the images that are: their edges are much wider than
    usual.
    """
    if not shots:
        return shots, []
    worst = [max(shot, key=lambda view: view.edge_px) for shot in shots]
    usual_px = float(np.percentile([view.edge_px for view in worst], 25))
    limit_px = max(_BLURRED_PX, _BLURRED_RATIO * usual_px)
    blurred = [
        RejectedView(view.name, f"blurred: its edges are {view.edge_px:.1f} px wide")
        for view in worst
        if view.edge_px > limit_px
    ]
    pairs = zip(shots, worst, strict=True)
    return [shot for shot, view in pairs if view.edge_px <= limit_px], blurred


def _check_board(board: Board, samples: Sequence[Image], *, n_found: int, n_images: int) -> None:
    """Raise CalibrationError if the images show another board than given, or no board."""
    if isinstance(board, CharucoBoard):
        if not n_found:
            raise CalibrationError(_no_charuco_message(board, samples, n_images))
        return
    seen = count_board_sizes(samples)
    expected = (max(board.grid), min(board.grid))
    commonest, votes = seen.most_common(1)[0] if seen else (expected, 0)
    # A single image may show part of a board, or a chequered shirt.
    if commonest != expected and votes > seen[expected] and votes >= min(2, len(samples)):
        raise CalibrationError(
            f"expected a board of {board.name} inner corners, found {_text(commonest)} in {votes} "
            f"of {len(samples)} images; give --board {_text(commonest)} (count the points where "
            "black squares touch, not the squares)."
        )
    if not n_found:
        raise CalibrationError(
            f"no board of {board.name} inner corners found in {counted(n_images, 'image')}; it "
            "must be completely visible, flat, evenly lit and with a white border, and --board "
            "counts the points where black squares touch."
        )


def _no_charuco_message(board: CharucoBoard, samples: Sequence[Image], n_images: int) -> str:
    seen = count_markers(samples[:2])
    # A dictionary of 100 markers starts with the dictionary of 50: the smallest of equally good
    # ones is right.
    best = max(
        seen,
        key=lambda name: (
            seen[name],
            -int(name.split("_")[-1]) if name.split("_")[-1].isdigit() else 0,
        ),
    )
    problem = f"no board {board.name} found in {counted(n_images, 'image')}"
    if not seen[best]:
        return (
            f"{problem}, and no ArUco marker; the board must be well lit, with markers at least 20 "
            "px wide."
        )
    if seen[board.dictionary] < seen[best]:
        return f"{problem}; the markers belong to the dictionary {best}; append it to --board."
    return f"{problem}, but its markers were found; check the numbers of squares, columns first."
