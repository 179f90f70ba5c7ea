"""The draft of a calibration with the files beside it that complete it: extrinsics, intrinsics, the
other camera.
"""

from dataclasses import replace
from pathlib import Path

from track_range.stereo.rig_formats.values.draft import RigDraft, read_draft
from track_range.stereo.rig_formats.values.partners import is_second, other_half, partner_of


def completed(draft: RigDraft, *, is_pair: bool) -> RigDraft:
    """The draft of a file, completed by files in its folder; by the file of the other camera only
    if `is_pair`.
    """
    path = draft.path
    has_cameras = draft.has("K", "fx")
    has_extrinsics = draft.has_extrinsics or draft.has("P", "baseline", "bf")
    is_single = has_cameras and len(draft.sides) < 2
    if has_extrinsics != has_cameras and (not is_single or "intrinsic" in path.stem):
        return _with_other_half(draft, has_cameras=has_cameras)
    if is_pair and is_single and not has_extrinsics:
        partner = partner_of(path)
        if partner is not None:
            return _with_partner(draft, partner)
    return draft


def _with_other_half(draft: RigDraft, *, has_cameras: bool) -> RigDraft:
    """The draft with the file of extrinsics, or one or two files of intrinsics."""
    other = other_half(draft.path, is_intrinsic=has_cameras)
    if other is None:
        return draft
    merged = draft | read_draft(other)
    if has_cameras or len(merged.sides) == 2:
        return merged
    partner = partner_of(other)
    return merged if partner is None else draft | _both(other, partner)


def _with_partner(draft: RigDraft, partner: Path) -> RigDraft:
    """The draft of both cameras' files, and of a file of extrinsics."""
    path = draft.path
    left, right = (partner, path) if is_second(path) else (path, partner)
    both = replace(
        _both(left, right), path=path, keys=draft.keys, beside=(partner,), dialect=draft.dialect
    )
    other = other_half(path, is_intrinsic=True)
    return both if other is None else both | read_draft(other)


def _both(left: Path, right: Path) -> RigDraft:
    """The drafts of the files of a left and a right camera."""
    return read_draft(left).of_one_side("left") | read_draft(right).of_one_side("right")
