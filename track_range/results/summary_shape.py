"""Schema of summary.json, for reading files that were damaged, edited, or written by another
version.

Values of wrong types are omitted, and the rest is used; keys that are not listed here may have any
value.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

Number = Annotated[float, Field(strict=True)]
Figure = Annotated[float, Field(strict=True, gt=-1e15, lt=1e15, allow_inf_nan=False)] | None
"""Finite number, or null = unknown; the limits are larger than any value of a run."""
_Interval = Annotated[list[Figure], Field(min_length=2, max_length=2)]
_FrameNumber = Annotated[int, Field(strict=True, ge=0, lt=10**9)]
Text = Annotated[str, Field(strict=True)] | None


class _Section(BaseModel):
    model_config = ConfigDict(extra="allow")


class _Figures(_Section):
    """Section in which all other keys are figures too."""

    __pydantic_extra__: dict[str, Figure | _Interval]


class _Band(_Figures):
    from_m: Number
    to_m: Number


class _Method(_Figures):
    bands: list[_Band] | None = None
    by_class: dict[str, dict[str, Figure | _Interval]] | None = None


class _RigDistance(_Figures):
    distance_m: Number


class _UserSpeed(_Figures):
    track_id: Number
    road_class: Annotated[str, Field(strict=True, alias="class")]
    speed_kmh: Figure
    speed_sigma_kmh: Figure
    from_s: Number


class _LineCounts(_Section):
    n: Number
    by_direction: dict[str, Number]
    by_class: dict[str, dict[str, Number]]
    n_speeds: Number
    median_speed_kmh: Figure
    p85_speed_kmh: Figure


class _ZoneCounts(_Section):
    n_enter: Number
    n_exit: Number
    median_dwell_s: Figure
    mean_speed_kmh: Figure


class _Approach(_Figures):
    track_id: Number
    road_class: Annotated[str, Field(strict=True, alias="class")]


class _LearntFocal(_Section):
    focal_px: Number
    focal_sigma: Number
    source: Annotated[str, Field(strict=True)]
    since_s: Number


class _LearntScale(_Figures):
    n_tracks: Number
    baseline_m: Number
    focal_px: Number
    relative_sigma: Number


def _section(base: type[BaseModel] = _Section, **kinds: Any) -> Any:
    """Section with optional keys of the given types."""
    return create_model(
        "_Part", __base__=base, **{name: (kind, None) for name, kind in kinds.items()}
    )  # type: ignore[call-overload]


def _all(kind: Any, names: str) -> dict[str, Any]:
    return dict.fromkeys(names.split(), kind)


class _Source(_Section):
    kind: Annotated[str, Field(strict=True)]
    source: Annotated[str, Field(strict=True)]
    focal_px: Number
    sigma: Number
    weight: Number
    density: list[Number]


class _Remedy(_Section):
    evidence: Annotated[str, Field(strict=True)]
    focal_sigma: Number


class _CameraEstimate(_Section):
    focal_px: Number
    focal_sigma: Number
    curve_px: list[Number]
    density: list[Number]
    sources: list[_Source]
    k1: Number | None = None
    k1_sigma: Number | None = None
    distortion: list[Number] = []
    remedy: _Remedy | None = None


_HEALTH = _section(
    **_all(Text, "state sentence move_sentence unseen"), distances=list[_RigDistance]
)
_SUMMARY = _section(
    **_all(
        Figure,
        "schema_version frames frames_dropped starts_s wall_s frames_per_s focal_px "
        "focal_sigma baseline_m lane_width_m lane_width_sigma_m",
    ),
    **_all(Text, "settings_hash truth calibration region"),
    **_all(dict[str, Figure], "stages_ms latency_ms stereo_unmatched stereo_surfaces"),
    **_all(dict[str, Figure | _Interval], "closing lateral"),
    targets=dict[str, Any],
    **_all(dict[str, _Method], "methods common"),
    **_all(dict[str, Any], "inputs settings versions"),
    files=dict[str, Text],
    notes=list[Text],
    shown_only=list[Text],
    networks=list[dict[str, Any]],
    health=list[dict[str, Any]] | None,
    utc=_section(**_all(Text, "start source"), uncertainty_s=Figure) | None,
    ego_speed=_section(source=Text, **_all(Figure, "offset_s offset_sigma_s median_mps coverage"))
    | None,
    tracks=_section(_Figures, classes=list[Text] | None, rule=Text) | None,
    events=_section(
        **_all(Figure, "n hours"), by_kind=dict[str, Figure], worst=dict[str, Any] | None
    )
    | None,
    alignment=_section(_Figures, source=Text, is_applied=Any, health=_HEALTH | None) | None,
    closest_approaches=list[_Approach],
    processed_frames=list[tuple[_FrameNumber, _FrameNumber]],
    learnt_scale=_LearntScale | None,
    learnt_focal=_LearntFocal | None,
    synchronisation=list[dict[str, Any]] | None,
    scale_doubt=_section(
        **_all(Figure, "factor sigma n_objects"), causes=dict[str, Figure], evidence=Text
    )
    | None,
    camera_estimate=_CameraEstimate | None,
    mounting=_section(**_all(Figure, "yaw_deg pitch_deg roll_deg sigma_deg"), source=Text) | None,
    visibility=_section(
        **_all(Figure, "brightness contrast sharpness outside dark bright flat blurred"),
        **_all(Text, "sentence figures"),
        is_low=bool,
        spans_s=list[list[Number]],
    )
    | None,
    fixed_camera=_section(
        ground=_section(source=Text, height_m=Figure, pitch_deg=Figure, focal_px=Figure) | None,
        road_users=list[_UserSpeed],
    )
    | None,
    counts=_section(lines=dict[str, _LineCounts], zones=dict[str, _ZoneCounts]) | None,
    baseline_check=_section(sigma=Figure | None, evidence=Text) | None,
)


def valid_summary(summary: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Part of a summary with values of the right types, and the dotted names of the omitted
    values.
    """
    valid, invalid = _copied(summary), list[str]()
    while True:
        try:
            _SUMMARY.model_validate(valid)
        except ValidationError as error:
            ordered = _invalid_places(error, valid)
            invalid += [".".join(map(str, path)) for path in ordered]
            for *sections, name in reversed(ordered):  # the last item of a list first
                container = valid
                for part in sections:
                    container = container[part]
                del container[name]
        else:
            return valid, invalid


def _invalid_places(
    error: ValidationError, summary: Mapping[str, Any]
) -> list[tuple[int | str, ...]]:
    """Places of invalid values, in order; a section without a required key is one as a whole."""
    places = (e["loc"][:-1] if e["type"] == "missing" else e["loc"] for e in error.errors())
    return sorted(
        {_existing(place, summary) for place in places},
        key=lambda place: [(-1, part) if isinstance(part, str) else (part, "") for part in place],
    )


def _existing(place: tuple[int | str, ...], value: Any) -> tuple[int | str, ...]:
    """The part of the place of an error that names keys and items; the rest names types of a
    union.
    """
    known: list[int | str] = []
    for part in place:
        is_item = isinstance(value, list) and isinstance(part, int)
        if not is_item and not (isinstance(value, dict) and part in value):
            break
        value = value[part]
        known.append(part)
    return tuple(known)


def _copied(value: Any) -> Any:
    """Deep copy with mutable mappings and lists; keys are strings."""
    if isinstance(value, Mapping):
        return {str(key): _copied(part) for key, part in value.items()}
    return [_copied(part) for part in value] if isinstance(value, list) else value
