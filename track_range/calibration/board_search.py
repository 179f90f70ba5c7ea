"""What boards the images of a calibration show: which views can be used, and why the others cannot.

Left out are images that cannot be read, that show no whole board, whose size is not the others' (one or two pixels more
or less are cut off) and that are blurred; of a film's many views those are kept that differ most.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from track_range.calibration.board_images import BoardImages, Shot
from track_range.foundation.arrays import Image
from track_range.stereo.calibration.board_views import (
    BoardFinder,
    BoardView,
    RejectedView,
    in_step,
    markers_seen,
    sizes_seen,
)
from track_range.stereo.calibration.boards import Board, CalibrationError, CharucoBoard
from track_range.stereo.calibration.coverage import varied

Advance = Callable[[int, int], None]
Views = tuple[BoardView, ...]
Size = tuple[int, int]

MAX_VIEWS = 60
"""More add time, not accuracy."""

_CROPPED_PX = 2
"""Sizes that differ by no more are the same camera's, rounded or cut by some program."""

_BLURRED_PX = 4.0
_BLURRED_TIMES = 2.5
"""Edges wider than both, the latter in units of the sharpest quarter's, are blurred."""

_N_SAMPLES = 6
"""Images kept to see what board they really show."""


@dataclass(frozen=True, slots=True)
class FoundViews:
    """The views of a calibration.

    Attributes:
        shots: one view, or one per eye, of each shot that can be used.
        rejected: the images left out.
        notes: what the user should know.
        n_images: how many shots there were.
    """

    shots: list[Views]
    rejected: list[RejectedView]
    notes: list[str]
    n_images: int


def find_views(images: BoardImages, board: Board, advance: Advance) -> FoundViews:
    """Look for the board in all images; `advance` is told steps done, and of how many.

    Raises:
        CalibrationError: no board in any of them, or a board of another size.
        VideoError: a film cannot be read.
    """
    finder = BoardFinder(board)
    shots: list[Views] = []
    rejected = list(images.left_out)
    samples: list[Image] = []
    n_images = 0
    for shot in images:
        n_images += 1
        advance(n_images, max(images.n_shots or 0, n_images))
        samples = _sampled(samples, shot, n_images, images.n_shots or 0)
        found = _found(finder, shot, is_film=images.is_film)
        if isinstance(found, RejectedView):
            rejected.append(found)
        else:
            shots.append(found)
    _check_board(board, samples, n_found=len(shots), n_images=n_images)
    notes: list[str] = []
    shots = _of_one_size(shots, rejected, notes)
    shots = _sharp(shots, rejected)
    return FoundViews(_varied(shots, notes), rejected, notes, n_images)


def _sampled(samples: list[Image], shot: Shot, number: int, n_shots: int) -> list[Image]:
    """The samples with this shot's first image, if it is its turn."""
    image = shot.images[0]
    if image is None or (number - 1) % max(1, n_shots // _N_SAMPLES) or len(samples) >= _N_SAMPLES:
        return samples
    return [*samples, image]


def _found(finder: BoardFinder, shot: Shot, *, is_film: bool) -> Views | RejectedView:
    """The views of a shot, or why it has none; a pair is as good as its worse eye."""
    views = []
    for name, image in zip(shot.names, shot.images, strict=True):
        if image is None:
            return RejectedView(name, "not an image, or a damaged one")
        if is_film and not finder.quick_look(image):
            return RejectedView(name, "no whole board found")
        view = finder.find(image, name)
        if isinstance(view, RejectedView):
            return view
        views.append(view)
    if len(views) == 1:
        return (views[0],)
    left, right = in_step(views[0], views[1], finder.board)
    n_common = len(left.corner_id)
    return (left, right) if n_common >= 6 else RejectedView(left.name, f"only {n_common} corners seen by both eyes")


def _of_one_size(shots: list[Views], rejected: list[RejectedView], notes: list[str]) -> list[Views]:
    """The shots whose images have, but for a pixel or two, the commonest size; cut to it."""
    if not shots:
        return shots
    n_eyes = len(shots[0])
    usual = [Counter(shot[eye].size_px for shot in shots).most_common(1)[0][0] for eye in range(n_eyes)]
    kept, cut = [], []
    for shot in shots:
        odd = [eye for eye in range(n_eyes) if not _is_near(shot[eye].size_px, usual[eye])]
        if odd:
            view, size = shot[odd[0]], usual[odd[0]]
            rejected.append(RejectedView(view.name, f"{_words(view.size_px)} px, where most have {_words(size)} px"))
            continue
        cut += [view.name for view, size in zip(shot, usual, strict=True) if view.size_px != size]
        kept.append(tuple(replace(view, size_px=size) for view, size in zip(shot, usual, strict=True)))
    if cut:
        sizes = " and ".join(dict.fromkeys(_words(size) for size in usual))
        notes.append(f"Cut to the others' {sizes} px at their right and lower edges: {', '.join(cut)}.")
    return kept


def _is_near(size: Size, usual: Size) -> bool:
    return all(abs(a - b) <= _CROPPED_PX for a, b in zip(size, usual, strict=True))


def _words(size: Size) -> str:
    return f"{size[0]}x{size[1]}"


def _sharp(shots: list[Views], rejected: list[RejectedView]) -> list[Views]:
    """The shots without those whose edges are much wider than the others'."""
    if not shots:
        return shots
    widths = np.array([max(view.edge_px for view in shot) for shot in shots])
    limit_px = max(_BLURRED_PX, _BLURRED_TIMES * float(np.percentile(widths, 25)))
    blurred = [shot for shot, width in zip(shots, widths, strict=True) if width > limit_px]
    for shot in blurred:
        worst = max(shot, key=lambda view: view.edge_px)
        rejected.append(RejectedView(worst.name, f"blurred: its edges are {worst.edge_px:.1f} px wide"))
    return [shot for shot, width in zip(shots, widths, strict=True) if width <= limit_px]


def _varied(shots: list[Views], notes: list[str]) -> list[Views]:
    if len(shots) <= MAX_VIEWS:
        return shots
    notes.append(f"{MAX_VIEWS} of {len(shots)} views used: those that differ most.")
    return [shots[i] for i in varied([shot[0] for shot in shots], MAX_VIEWS)]


def _check_board(board: Board, samples: Sequence[Image], *, n_found: int, n_images: int) -> None:
    """Refuse images of another board than the one named, and images of none."""
    if isinstance(board, CharucoBoard):
        if not n_found:
            raise CalibrationError(_why_no_charuco(board, samples, n_images))
        return
    seen = sizes_seen(samples)
    expected = (max(board.grid), min(board.grid))
    commonest, votes = seen.most_common(1)[0] if seen else (expected, 0)
    # One image alone may show a part of a board, or of a chequered shirt.
    if commonest != expected and votes > seen[expected] and votes >= min(2, len(samples)):
        raise CalibrationError(
            f"{votes} of {len(samples)} images looked at show a board of {_words(commonest)} inner corners, not "
            f"{board.name}; give --board {_words(commonest)} (where black squares touch, not squares, are counted)."
        )
    if not n_found:
        raise CalibrationError(
            f"no board of {board.name} inner corners found in any of {_counted(n_images)}; it must be whole in view, "
            "flat, in even light and with a white rim, and --board counts where black squares touch."
        )


def _why_no_charuco(board: CharucoBoard, samples: Sequence[Image], n_images: int) -> str:
    seen = markers_seen(samples[:2])
    # A set of 50 markers is the start of the set of 100: the smallest that explains as many is the one.
    best = max(seen, key=lambda name: (seen[name], -int(name.split("_")[-1]) if name.split("_")[-1].isdigit() else 0))
    said = f"no board {board.name} found in any of {_counted(n_images)}"
    if not seen[best]:
        return f"{said}, nor any ArUco marker; it must be well lit, with markers 20 px wide or more."
    if seen[board.dictionary] < seen[best]:
        return f"{said}; their markers are of the dictionary {best}: put that at the end of --board."
    return f"{said}; there are markers of {board.dictionary}: check the numbers of squares, columns first."


def _counted(n_images: int) -> str:
    return f"{n_images} image{'' if n_images == 1 else 's'}"
