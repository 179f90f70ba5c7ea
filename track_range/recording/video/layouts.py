"""Layouts of images: of two cameras in one image, and of colours behind a Bayer filter."""

from typing import Literal

PackedLayout = Literal["side-by-side", "right-left", "top-bottom", "bottom-top"]
"""Layout of the images of two cameras in one image: beside or below each other, the left camera's
first or second."""

STACKED: tuple[PackedLayout, ...] = ("top-bottom", "bottom-top")  # below each other
REVERSED: tuple[PackedLayout, ...] = ("right-left", "bottom-top")  # the right camera's first

StereoLayout = Literal[PackedLayout, "tracks"]  # the same, or in two video tracks of a recording

LayoutOption = Literal["auto", StereoLayout]
# colours of the first two pixels of the first two rows
Bayer = Literal["rggb", "bggr", "gbrg", "grbg"]
