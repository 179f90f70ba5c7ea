"""Growth of objects in the images since their key frames."""

from typing import NamedTuple

from track_range.foundation.arrays import BoolArray, FloatArray


class Growth(NamedTuple):
    """Sizes of N tracks in the image relative to the sizes in their key frames, (N,) each."""

    log_ratio: FloatArray  # log(size now / size in the key frame); NaN = not measured
    sigma: FloatArray  # its standard deviation
    is_key: BoolArray  # whether this frame becomes the key frame of those that follow
