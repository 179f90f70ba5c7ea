"""Drives without images in one scene, with their tracks and the truth of their contacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.boxes.box_drive import BoxDrive
from benchmarks.boxes.box_run import Step, tracked
from benchmarks.boxes.true_boxes import closing_rates_mps
from benchmarks.inputs.conflict_drives import COLLISIONS, FPS
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.simulation.world.contacts import find_contacts
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scene import Scene

HARMLESS_S, COLLISION_S = 20.0, 8.0
"""Length of a drive, s."""

WIDTH_PX, HEIGHT_PX = 620, 188
"""Size of the images, px: that of the fit."""


@dataclass(frozen=True, slots=True)
class SceneDrives:
    """Drives with different errors in the scene of a scenario and seed.

    Attributes:
        scenario, seed: the scene.
        scene: the scene.
        drives: the drives.
        tracks: frames and tracks of each drive.
        contact_s: time of the contact by id of the road user.
        is_real: whether the contacts happen, without braking or with it.
        end_s: time of the first contact, or of the last frame; later frames do not count.
        object_id: (N + 1,) id of each road user; the last one, -1, is that of false boxes (row -1).
        closing_mps: (N, T) true closing speeds.
    """

    scenario: str
    seed: int
    scene: Scene
    drives: list[BoxDrive]
    tracks: list[list[Step]]
    contact_s: dict[int, float]
    is_real: bool
    end_s: float
    object_id: IntArray
    closing_mps: FloatArray

    @property
    def hours(self) -> float:
        """Duration of all drives, h."""
        return len(self.drives) * self.end_s / 3600


def scene_drives(scenario: str, seed: int, n_errors: int) -> SceneDrives:
    """The drives of a scenario and seed; the same arguments give the same drives."""
    seconds = COLLISION_S if scenario in COLLISIONS else HARMLESS_S
    scene = make_scenario(scenario, seed=seed, seconds=seconds)
    contacts = find_contacts(scene, seconds)
    contact_s = {contact.track_id: contact.contact_s for contact in contacts}
    is_real = all(contact.is_real for contact in contacts)
    times_s = np.arange(round(seconds * FPS)) / FPS
    rig = kitti_like_rig(width_px=WIDTH_PX, height_px=HEIGHT_PX)
    first = BoxDrive(scene, times_s, rig, seed=1000 * seed)
    others = [BoxDrive(scene, times_s, rig, seed=1000 * seed + number, like=first) for number in range(1, n_errors)]
    drives = [first, *others]
    return SceneDrives(
        scenario,
        seed,
        scene,
        drives,
        [tracked(drive) for drive in drives],
        contact_s,
        is_real,
        min(contact_s.values(), default=seconds) if is_real else seconds,
        np.array([user.track_id for user in scene.road_users] + [-1]),
        closing_rates_mps(scene, times_s),
    )
