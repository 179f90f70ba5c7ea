r"""Contacts of the ego vehicle with road users, exact from the geometry of the scene.

The ego vehicle is a box of `EGO_HWL_M` on the road. The left camera is above its centre line, `CAMERA_TO_FRONT_M`
behind its front; the box follows the road's direction and slope but not the wobble of the camera.

    rear |-------- 2.7 m ---------(camera)--- 1.5 m ---| front

A contact is the first instant at which the boxes of the ego vehicle and of a road user touch in three dimensions. Two
kinds count:

    real          the boxes touch while all move as in the scene. It ends the search: what follows is the crash.
    hypothetical  the ego vehicle brakes in the scene. For each time b at which it starts to brake (0 if it brakes
                  already), it continues from its position at b along the centre of its lane with its speed at b, while
                  all others move as in the scene; the first contact until b + `UNBRAKED_S` counts, ...
                  unless it is with a vehicle that the ego vehicle merely followed: a vehicle with wheels in the same
                  direction, in its path at b, at a time gap of at least `FOLLOWING_GAP_S`. A driver who reacts
                  normally to normal braking of the traffic ahead (queue, city) has no conflict; a driver in front of
                  whom a car has cut in (cut-in), or a person crosses, has one.

Contacts after the end of the drive do not count. An object has one contact, the earliest.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.simulation.world.road_shape import RoadShape, slope_rotation, yaw_rotation
from track_range.simulation.world.scene import RoadUser, Scene

EGO_HWL_M = (1.5, 1.8, 4.2)  # height, width and length of the ego vehicle, m: a compact car
# along the road from the left camera to the front of the ego vehicle: behind the windscreen
CAMERA_TO_FRONT_M = 1.5
# s from the start of braking to a hypothetical contact: ISO 15623 warns at most about 4 s ahead
UNBRAKED_S = 4.0
FOLLOWING_GAP_S = 1.0  # smallest gap to a followed vehicle; below it a driver cannot react in time
STEP_S = 0.005  # time step of the search, s; the contact itself is found by bisection
PRECISION_S = 1e-6  # precision of the time of contact, s

_VEHICLES = ("Car", "Van", "Truck", "Bus", "Motorcycle", "Cyclist")
_ALIGNED_RAD = np.pi / 4


@dataclass(frozen=True, slots=True)
class EgoContact:
    """A contact of the ego vehicle with a road user."""

    track_id: int
    kitti_type: str
    contact_s: float  # time at which the boxes touch first
    is_real: bool  # False for a contact that happens only without braking


def find_contacts(scene: Scene, seconds: float) -> tuple[EgoContact, ...]:
    """The contacts in the first `seconds` of a scene, earliest first, as the module defines
    them.
    """
    contacts: dict[int, EgoContact] = {}
    real = first_contact(scene, seconds)
    end_s = seconds if real is None else real.contact_s
    for start_s in _brake_starts_s(scene, end_s):
        hypothetical = _unbraked_contact(scene, start_s, seconds)
        if hypothetical is not None:
            known = contacts.get(hypothetical.track_id, hypothetical)
            contacts[hypothetical.track_id] = min(
                known, hypothetical, key=lambda contact: contact.contact_s
            )
    if real is not None:
        contacts[real.track_id] = real
    return tuple(sorted(contacts.values(), key=lambda contact: contact.contact_s))


def first_contact(scene: Scene, seconds: float) -> EgoContact | None:
    """The first real contact in the first `seconds` of a scene; None = no contact."""
    return _first_touch(scene, scene.ego_z_m, (0.0, seconds), is_real=True)


def _unbraked_contact(scene: Scene, start_s: float, seconds: float) -> EgoContact | None:
    """The first contact if the ego vehicle keeps its speed from `start_s` on, except with followed
    vehicles.
    """
    z_m, speed_mps = scene.ego_z_m(start_s), _along_z_mps(scene, start_s)
    end_s = min(start_s + UNBRAKED_S, seconds)
    from_to_s = (start_s, end_s)
    contact = _first_touch(
        scene, lambda times_s: z_m + speed_mps * (times_s - start_s), from_to_s, is_real=False
    )
    return None if contact is None or _is_followed(scene, contact.track_id, start_s) else contact


def _brake_starts_s(scene: Scene, end_s: float) -> Iterator[float]:
    """The times before `end_s` at which the ego vehicle starts to brake, 0 if it brakes already."""
    was_braking = False
    for (from_s, from_mps), (to_s, to_mps) in pairwise(scene.ego_speed_changes):
        is_braking = to_mps < from_mps
        if is_braking and not was_braking and to_s > 0 and from_s < end_s:
            yield max(from_s, 0.0)
        was_braking = is_braking


def _along_z_mps(scene: Scene, time_s: float) -> float:
    return scene.speed_mps(time_s) / scene.road.stretch(scene.ego_z_m(time_s))


def _is_followed(scene: Scene, track_id: int, time_s: float) -> bool:
    """Whether the ego vehicle follows a road user at a time: a vehicle in its path with a
    sufficient time gap.
    """
    user = next(user for user in scene.road_users if user.track_id == track_id)
    heading_rad = user.heading_rad(time_s) + np.pi / 2
    is_aligned = abs(np.arctan2(np.sin(heading_rad), np.cos(heading_rad))) < _ALIGNED_RAD
    if user.kitti_type not in _VEHICLES or not is_aligned:
        return False
    across_m, z_m = user.on_road_m(time_s)
    _, width_m, length_m = user.size_hwl_m
    is_in_path = abs(across_m) < (EGO_HWL_M[1] + width_m) / 2
    gap_m = z_m - length_m / 2 - scene.ego_z_m(time_s) - CAMERA_TO_FRONT_M
    return is_in_path and gap_m >= FOLLOWING_GAP_S * _along_z_mps(scene, time_s)


def _first_touch(
    scene: Scene,
    ego_at_m: Callable[[FloatArray], FloatArray],
    from_to_s: tuple[float, float],
    *,
    is_real: bool,
) -> EgoContact | None:
    """The contact with the first road user that touches the ego vehicle, whose camera is at z =
    `ego_at_m(time)`.
    """
    times_s = np.append(np.arange(*from_to_s, STEP_S), from_to_s[1])
    users, size_hwl_m, ego_z = scene.road_users, scene.size_hwl_m(), ego_at_m(times_s)
    across_m, z_m = (
        np.array([user.on_road_m(times_s) for user in users])
        .reshape(-1, 2, len(times_s))
        .swapaxes(0, 1)
    )
    reach_m = (
        np.hypot(size_hwl_m[:, 1:2], size_hwl_m[:, 2:]) / 2
        + np.hypot(*EGO_HWL_M[1:]) / 2
        + CAMERA_TO_FRONT_M
    )
    rows = np.flatnonzero(
        ((np.abs(z_m - ego_z) < reach_m) & (np.abs(across_m) < reach_m)).any(axis=1)
    )
    if not len(rows):
        return None
    touches = np.stack([_touches(scene.road, users[row], times_s, ego_z) for row in rows.tolist()])
    steps = np.where(touches.any(axis=1), touches.argmax(axis=1), len(times_s))
    if steps.min() == len(times_s):
        return None
    step = int(steps.min())
    around_s = float(times_s[max(step - 1, 0)]), float(times_s[step])
    touching = [
        (_bisected_s(scene, row, ego_at_m, *around_s), row) for row in rows[steps == step].tolist()
    ]
    contact_s, row = min(touching)
    return EgoContact(users[row].track_id, users[row].kitti_type, contact_s, is_real)


def _bisected_s(
    scene: Scene,
    row: int,
    ego_at_m: Callable[[FloatArray], FloatArray],
    before_s: float,
    after_s: float,
) -> float:
    """The time of the first touch between two times, before and after it."""
    user = scene.road_users[row]
    while after_s - before_s > PRECISION_S:
        middle_s = (before_s + after_s) / 2
        times_s = np.array([middle_s])
        if _touches(scene.road, user, times_s, ego_at_m(times_s))[0]:
            after_s = middle_s
        else:
            before_s = middle_s
    return after_s


def _touches(
    road: RoadShape, user: RoadUser, times_s: FloatArray, ego_z_m: FloatArray
) -> BoolArray:
    """(T,) whether the boxes of a road user and of the ego vehicle touch at T times."""
    across_m, z_m = user.on_road_m(times_s)
    centre = _on_road(road, across_m, z_m, user.raised_m)
    axes = slope_rotation(road.climb_rad(z_m)) @ yaw_rotation(
        user.heading_rad(times_s) + road.yaw_rad(z_m)
    )
    middle_z_m = ego_z_m + (CAMERA_TO_FRONT_M - EGO_HWL_M[2] / 2) / np.sqrt(
        1 + np.tan(road.yaw_rad(ego_z_m)) ** 2 + np.tan(road.climb_rad(ego_z_m)) ** 2
    )
    ego_centre = _on_road(road, np.zeros_like(ego_z_m), middle_z_m, 0.0)
    ego_axes = slope_rotation(road.climb_rad(middle_z_m)) @ yaw_rotation(
        road.yaw_rad(middle_z_m) - np.pi / 2
    )
    return boxes_touch((centre, axes, user.size_hwl_m), (ego_centre, ego_axes, EGO_HWL_M))


def _on_road(road: RoadShape, across_m: FloatArray, z_m: FloatArray, raised_m: float) -> FloatArray:
    """(T, 3) positions in world axes."""
    return np.stack([road.x_m(z_m, across_m), road.y_m(z_m) - raised_m, z_m], axis=1)


Boxes = tuple[FloatArray, FloatArray, tuple[float, float, float]]
"""(T, 3) bottom centres, (T, 3, 3) rotations from the box frame (x along the length, y down, z
across), and size."""


def boxes_touch(first: Boxes, second: Boxes) -> BoolArray:
    """(T,) whether two boxes touch or overlap, by the separating axis theorem.

    Two convex boxes are apart exactly if their projections on one of 15 axes do not overlap: the
    three axes of each box and the nine cross products of one axis of each.
    """
    (centre_a, axes_a, size_a), (centre_b, axes_b, size_b) = first, second
    half_a, half_b = (
        np.array([length, height, width]) / 2 for height, width, length in (size_a, size_b)
    )
    middle_a, middle_b = (
        centre_a - axes_a[:, :, 1] * half_a[1],
        centre_b - axes_b[:, :, 1] * half_b[1],
    )
    a, b = axes_a.transpose(0, 2, 1), axes_b.transpose(0, 2, 1)  # rows are axes
    crossed = np.cross(a[:, :, None, :], b[:, None, :, :]).reshape(len(a), 9, 3)
    directions = np.concatenate([a, b, crossed], axis=1)
    reach = np.abs(directions @ axes_a) @ half_a + np.abs(directions @ axes_b) @ half_b
    apart = np.abs((directions @ (middle_b - middle_a)[:, :, None])[:, :, 0])
    is_axis = np.linalg.norm(directions, axis=2) > 1e-9  # cross products of parallel axes are none
    return np.asarray(~((apart > reach) & is_axis).any(axis=1))
