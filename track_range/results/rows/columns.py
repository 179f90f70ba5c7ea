"""Columns of the rows of a run (one row per track and frame): the table of their declarations.

tracks.csv, the table in memory, all other formats with rows, the frames that are made from rows,
and the documentation derive from it. The order of the first columns is fixed for readers of
tracks.csv; the columns of ranging methods of other packages follow at the end.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress

from track_range.detection.classes import ROAD_CLASSES
from track_range.ranging.methods.method import MethodError, RangingMethod
from track_range.ranging.registry import METHODS, methods, register_networks
from track_range.ranging.world.object_motion import MOTION_STATES
from track_range.results.rows.column import ResultColumn

# of files that are read; runs with all methods have fewer than 100, and pyarrow is slow with more
MAX_COLUMNS = 1000
MAX_NAME = 200  # largest number of characters of a name that is read, such as that of a class

_SIGMA = "its standard deviation"

_FIRST = (
    ResultColumn("frame", "", "frame.index", "number of the frame, from 0", "whole"),
    ResultColumn(
        "time_s",
        "s",
        "frame.time_s",
        "time of the frame from the start of the video, by its timestamps",
        decimals=6,
        largest=1e9,  # 30 years of video
    ),
    ResultColumn("track_id", "", "tracks.track_id", "identity, from 1", "whole"),
    ResultColumn(
        "class", "", "tracks.class_id", ", ".join(ROAD_CLASSES), "name", names=ROAD_CLASSES
    ),
    ResultColumn(
        "score",
        "",
        "tracks.score",
        "confidence of the detection, 0 to 1; it decays while a box is predicted",
        decimals=4,
    ),
    ResultColumn(
        "observed",
        "",
        "tracks.observed",
        "1 = detected in this frame, 0 = predicted",
        "flag",
        missing=True,
    ),
    ResultColumn("x1_px", "px", "tracks.xyxy_px.0", "left edge of the box"),
    ResultColumn("y1_px", "px", "tracks.xyxy_px.1", "top edge"),
    ResultColumn("x2_px", "px", "tracks.xyxy_px.2", "right edge"),
    ResultColumn("y2_px", "px", "tracks.xyxy_px.3", "bottom edge"),
)

_APPROACH = (
    ResultColumn(
        "x_m",
        "m",
        "world.xyz_m.0",
        "x of the measured point (right of the camera), from the fused distance",
    ),
    ResultColumn(
        "x_sigma_m",
        "m",
        "world.xy_sigma_m.0",
        "its standard deviation: by the distance, the box and the principal point",
    ),
    ResultColumn(
        "y_m",
        "m",
        "world.xyz_m.1",
        "y of the measured point (below the camera), from the fused distance",
    ),
    ResultColumn("y_sigma_m", "m", "world.xy_sigma_m.1", _SIGMA),
    ResultColumn(
        "closing_mps",
        "m/s",
        "approach.closing_mps",
        "closing speed: how fast the gap shrinks; negative = it grows",
        viewer_name="closing_mps",
    ),
    ResultColumn(
        "closing_sigma_mps",
        "m/s",
        "approach.closing_sigma_mps",
        _SIGMA,
        viewer_name="closing_sigma_mps",
    ),
    ResultColumn(
        "ttc_s",
        "s",
        "approach.ttc_s",
        "time to collision [with the camera]: filtered distance over closing speed, where the gap "
        "shrinks",
        viewer_name="ttc_s",
    ),
    ResultColumn("ttc_sigma_s", "s", "approach.ttc_sigma_s", _SIGMA),
    ResultColumn(
        "utc",
        "s",
        "frame.utc_s",
        "[time of the frame] in seconds since 1970-01-01 00:00 UTC; empty = unknown",
        decimals=6,
        largest=4e9,  # the year 2096
    ),
    ResultColumn(
        "ego_mps",
        "m/s",
        "ego.speed_mps",
        "[speed of the camera] along its axis, in every row of a frame; empty = unknown",
    ),
    ResultColumn(
        "contact_probability",
        "",
        "alarms.warnings.probability",
        "[probability of contact] within the horizon, 0 to 1; empty = unknown",
    ),
    ResultColumn(
        "warning",
        "",
        "alarms.warnings.active",
        "1 during the [collision warning] of the track",
        "flag",
    ),
    ResultColumn(
        "path_offset_m",
        "m",
        "alarms.warnings.path_offset_m",
        "lateral offset of the object from the middle of the ego path, positive = right",
    ),
)

_MOTION = (
    ResultColumn(
        "speed_mps",
        "m/s",
        "world.motion.speed_mps",
        '[speed over ground], as the mean of the hypotheses "at rest" and "moving"; empty without '
        "ego speed, and where its sigma is above 3 m/s",
        viewer_name="speed_mps",
    ),
    ResultColumn(
        "speed_sigma_mps",
        "m/s",
        "world.motion.speed_sigma_mps",
        "standard deviation of `speed_mps`",
        viewer_name="speed_sigma_mps",
    ),
    ResultColumn(
        "heading_deg",
        "deg",
        "world.motion.heading_deg",
        "direction of motion in the frame [map], counterclockwise, -180 to 180; empty at rest",
        decimals=2,
        viewer_name="heading_deg",
    ),
    ResultColumn(
        "world_x_m",
        "m",
        "world.motion.world_x_m",
        "position of the object in the frame `map`: the middle of its visible side at the filtered "
        "distance",
        viewer_name="world_x_m",
    ),
    ResultColumn(
        "world_y_m",
        "m",
        "world.motion.world_y_m",
        "y of the same position",
        viewer_name="world_y_m",
    ),
    ResultColumn(
        "state",
        "",
        "world.motion.state",
        "`parked` (at rest), `moving` (in the direction of the ego vehicle), `oncoming`, "
        "`crossing`; empty = unknown. A state is stated once its probability has been at least 0.8 "
        "for 0.3 s, and until it falls below 0.5",
        "name",
        names=MOTION_STATES,
    ),
)

_SAFETY = (
    ResultColumn(
        "gap_m",
        "m",
        "alarms.safety.gap_m",
        "distance from the front of the ego vehicle; this and the following columns are [measures "
        "of safety]",
    ),
    ResultColumn(
        "ttc_front_s",
        "s",
        "alarms.safety.ttc_front_s",
        "time to collision of the front with objects on the path; reports and events use this time",
    ),
    ResultColumn(
        "headway_s", "s", "alarms.safety.headway_s", "gap over ego speed, of objects on the path"
    ),
    ResultColumn(
        "drac_mps2",
        "m/s2",
        "alarms.safety.drac_mps2",
        "deceleration required to avoid a contact, of objects on the path",
    ),
    ResultColumn(
        "mdrac_mps2",
        "m/s2",
        "alarms.safety.mdrac_mps2",
        "deceleration required after a reaction time of 1 s",
    ),
    ResultColumn(
        "tet_s",
        "s",
        "alarms.safety.tet_s",
        "time that the track has spent so far at a time to collision below 3 s",
    ),
    ResultColumn(
        "tit_s2",
        "s2",
        "alarms.safety.tit_s2",
        "integral of (3 s - time to collision) over this time",
    ),
    ResultColumn(
        "lane_index",
        "",
        "alarms.safety.lane_index",
        "-1 = lane to the left, 0 = ego lane, 1 = to the right; empty = beyond these",
    ),
    ResultColumn(
        "lane_index_sigma",
        "",
        "alarms.safety.lane_index_sigma",
        "standard deviation of `lane_index`",
    ),
    ResultColumn(
        "is_lead", "", "alarms.safety.is_lead", "1 = next vehicle ahead on the path", "flag"
    ),
)

_LATER = (  # that were added after all others: readers by position keep their columns
    ResultColumn(
        "state_probability",
        "",
        "world.motion.state_probability",
        "probability that `state` is right, 0.5 to 1",
        decimals=4,
    ),
    ResultColumn(
        "lateral_mps",
        "m/s",
        "world.placement.lateral_mps",
        "change of the position to the right of the camera per second, beside `closing_mps`; it "
        "contains the turn of the camera",
    ),
    ResultColumn("lateral_sigma_mps", "m/s", "world.placement.lateral_sigma_mps", _SIGMA),
    ResultColumn(
        "vehicle_x_m",
        "m",
        "world.placement.vehicle_m.0",
        "x (forward) of the object in the axes of the [vehicle], at the filtered distance; empty "
        "without a mounting",
    ),
    ResultColumn(
        "vehicle_y_m", "m", "world.placement.vehicle_m.1", "y (to the left) of the same position"
    ),
    ResultColumn(
        "vehicle_z_m",
        "m",
        "world.placement.vehicle_m.2",
        "z (above the road) of the same position; empty without the height of the camera",
    ),
    ResultColumn(
        "is_cut",
        "",
        "approach.is_cut",
        "1 = the left or right image border cuts the box, so that minima do not count it",
        "flag",
    ),
)

_CUBOIDS = (
    *(
        ResultColumn(f"{side}{part}_m", "m", f"world.cuboids.lwh{part}_m.{axis}", meaning)
        for axis, side in enumerate(("length", "width", "height"))
        for part, meaning in (("", f"{side} of the object, the [cuboid]"), ("_sigma", _SIGMA))
    ),
    ResultColumn(
        "yaw_deg",
        "deg",
        "world.cuboids.yaw_deg",
        "direction of the front of the cuboid from the axis of the camera, counterclockwise seen "
        "from above, -180 to 180; 0 = it drives as the camera looks",
        decimals=2,
    ),
    ResultColumn(
        "yaw_sigma_deg",
        "deg",
        "world.cuboids.yaw_sigma_deg",
        "its standard deviation, modulo 180 where `front_known` is 0",
        decimals=2,
    ),
    ResultColumn(
        "front_known",
        "",
        "world.cuboids.front_known",
        "1 = front and back are told apart; 0 = `yaw_deg` may be turned by 180 degrees",
        "flag",
    ),
    *(
        ResultColumn(f"centre_{axis}{part}_m", "m", f"world.cuboids.centre{part}_m.{i}", meaning)
        for i, (axis, place) in enumerate(
            (("x", "right of"), ("y", "below"), ("z", "in front of, along the axis of"))
        )
        for part, meaning in (
            ("", f"{axis} of the centre of the cuboid ({place} the camera)"),
            ("_sigma", _SIGMA),
        )
    ),
    *(
        ResultColumn(
            f"centre_{axes}_correlation",
            "",
            f"world.cuboids.centre_correlation.{i}",
            f"correlation of the errors of {axes[0]} and {axes[1]} of the centre",
            decimals=4,
        )
        for i, axes in enumerate(("xy", "xz", "yz"))
    ),
    *(
        ResultColumn(f"centre_{frame}_{axis}_m", "m", f"world.cuboids.{frame}_m.{i}", meaning)
        for frame, where, unknown in (
            ("vehicle", "in the axes of the [vehicle]", "without a mounting"),
            ("world", "in the frame [map]", "without an ego speed"),
        )
        for i, axis in enumerate("xyz")
        for meaning in (f"{axis} of the same centre {where}; empty {unknown}",)
    ),
)

_TRUTH = (  # that are added to the rows where there is ground truth, and are in no file
    ResultColumn("truth_m", "m", "", "true distance"),
    ResultColumn("scored_truth_m", "m", "", "the same of objects that count for the errors"),
)


def result_columns(optional: Collection[str] | None = ()) -> tuple[ResultColumn, ...]:
    """The columns of a run, in the order of tracks.csv; of optional methods only those that are
    named, at the end (None = of all).

    Raises MethodError: a method of another package has a column with the name of another one.
    """
    distances = [column for name in _first_distances() for column in _distance_columns(name)]
    columns = (*_FIRST, *distances, *_APPROACH)
    names = {column.name for column in columns}
    built_in = _built_in()
    by_distance = _method_columns(method for method in built_in if method.measures_distance)
    own = [column for column in by_distance if column.name not in names]
    without_distance = _method_columns(
        method for method in built_in if not method.measures_distance
    )
    others = _method_columns(_others(optional))
    all_columns = (
        *columns,
        *own,
        *_MOTION,
        *_SAFETY,
        *without_distance,
        *_LATER,
        *_CUBOIDS,
        *others,
    )
    _check_names(column.name for column in all_columns)
    return all_columns


def _built_in() -> list[RangingMethod]:
    """The methods whose columns all runs have, at fixed places."""
    return [method for method in methods(()) if method.name in METHODS.built_in]


def _others(optional: Collection[str] | None = None) -> list[RangingMethod]:
    """The methods of other packages, and the optional ones that are named (None = all)."""
    of_all = {method.name for method in _built_in()}
    return [method for method in methods(optional) if method.name not in of_all]


def _check_names(names: Iterable[str]) -> None:
    """Raise MethodError if two columns have one name, which only methods of other packages cause."""
    repeated = [name for name, n in Counter(names).items() if n > 1]
    if not repeated:
        return
    others = [method.name for method in _others()]
    causes = [name for name in others if any(column.startswith(f"{name}_") for column in repeated)]
    raise MethodError(
        f"ranging method {' and '.join(causes)}: its columns would have the names of others "
        f"({', '.join(repeated)}); give the method or its detail another name."
    )


def declared_columns() -> dict[str, ResultColumn]:
    """All columns of files by name, and those of the ground truth."""
    return {column.name: column for column in (*result_columns(None), *_TRUTH)}


def _first_distances() -> list[str]:
    """Names of the distances of the first columns: by the built-in methods, fused, and filtered."""
    built_in = [method for method in _built_in() if method.measures_distance]
    filtered = [f"{method.name}_kf" for method in built_in if method.is_filtered]
    return [*(method.name for method in built_in), "fused", *filtered, "fused_kf"]


def _distance_columns(name: str) -> Iterator[ResultColumn]:
    """Columns NAME_m and NAME_sigma_m of a distance of frames."""
    if name.endswith("_kf"):
        meaning = f"{name.removesuffix('_kf')} after its [filter]"
    elif name == "fused":
        meaning = "[fused] distance"
    else:
        meaning = f"distance by [{name}]"
    is_shown = name == "fused"
    for part, text in (("distance_m", meaning), ("sigma_m", _SIGMA)):
        yield ResultColumn(
            f"{name}_{part.removeprefix('distance_')}",
            "m",
            f"ranges.{name}.{part}",
            text,
            viewer_name=part if is_shown else "",
        )


def _method_columns(chosen: Iterable[RangingMethod]) -> Iterator[ResultColumn]:
    """Columns of the distances of these methods and of their filters, if any, and NAME_DETAIL."""
    for method in chosen:
        names = (method.name, *([f"{method.name}_kf"] if method.is_filtered else []))
        for name in names if method.measures_distance else ():
            yield from _distance_columns(name)
        for detail in method.details:
            meaning = method.details[detail] if isinstance(method.details, Mapping) else ""
            place = f"ranges.{method.name}.details.{detail}"
            unit = "s" if detail.endswith("_s") else ""
            yield ResultColumn(f"{method.name}_{detail}", unit, place, meaning)


def learn_networks(names: Iterable[str]) -> None:
    """Register the methods of networks whose distances are among the columns of a file, so that its
    readers know them as the run did.
    """
    with suppress(MethodError):  # a file with more networks than letters has them as other columns
        register_networks(name.removesuffix("_m") for name in names if name.endswith("_m"))


def column_names() -> list[str]:
    """Column names in the header of tracks.csv, without those of optional methods."""
    return [column.name for column in result_columns()]


def text_columns() -> frozenset[str]:
    """Names of the columns of names; all others are numbers in files."""
    return frozenset(column.name for column in result_columns() if column.kind == "name")


def viewer_columns() -> dict[str, ResultColumn]:
    """The columns of numbers in messages for viewers, by their names there."""
    return {column.viewer_name: column for column in result_columns() if column.viewer_name}


def methods_with_sigma() -> list[str]:
    """Names of all distances with a sigma (methods, "fused", filtered ones as NAME_kf), in the
    order of the summary.
    """
    names = [
        column.name.removesuffix("_sigma_m")
        for column in result_columns(None)
        if column.place.startswith("ranges.") and column.name.endswith("_sigma_m")
    ]
    return sorted(names, key=lambda name: name.endswith("_kf"))


def distance_names(names: Iterable[str]) -> list[str]:
    """Names NAME of the columns NAME_m that are distances, in their order.

    These are registered methods, "fused" and filtered ones, and methods of packages that are not
    installed here: columns that this installation does not have.
    """
    known, others = set(methods_with_sigma()), declared_columns()
    listed = [
        name.removesuffix("_m")
        for name in names
        if name.endswith("_m") and not name.endswith("_sigma_m")
    ]
    return [name for name in listed if name in known or f"{name}_m" not in others]
