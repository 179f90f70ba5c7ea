"""Renderer: the left or right image of a scene at any time, drawn with 2 x 2 samples per pixel
(`canvas.py`).

faces of street, road users and obstacles -> canvas -> lens -> headlights, at night -> faults ->
sensor noise
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import replace
from functools import cache
from itertools import repeat
from statistics import NormalDist
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.simulation.camera.fault_options import NO_FAULTS, Faults
from track_range.simulation.camera.faults import right_camera, with_blur_and_gain, with_rain
from track_range.simulation.camera.wide_lens import SideView, WideLens
from track_range.simulation.render.canvas import Canvas
from track_range.simulation.render.face_table import FaceTable, TextureStore
from track_range.simulation.render.night import lamps_of, night_image
from track_range.simulation.render.street import FAR_M, Street
from track_range.simulation.render.surface import Surface
from track_range.simulation.world.bodies.faces import Face
from track_range.simulation.world.bodies.obstacles import body_of_obstacle
from track_range.simulation.world.bodies.road_users import body_of
from track_range.simulation.world.road_shape import AHEAD, CameraPose, yaw_rotation
from track_range.simulation.world.scene import Scene
from track_range.simulation.world.textures.scenery import sky_picture
from track_range.simulation.world.truth import corners_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.geometry.virtual_pinhole import view_from_camera

Side = Literal["left", "right"]  # a camera of the pair
SAMPLES = 2  # samples per pixel and axis
LONGEST_HALF_M = 8.0  # largest distance between the centre of a body and its nearest point, m
LENS_BLUR_SAMPLES = 0.8  # standard deviation, about 0.4 px; without blur the image would be aliased
# width and height of the sky relative to the image, for a camera that rotates
SKY_SIZE = (1.7, 1.5)


# from half-size to full-size pixels
_FROM_HALF = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]])


def kitti_like_rig(
    *, width_px: int = 1240, height_px: int = 376, baseline_m: float = 0.54
) -> StereoRig:
    """A rectified pair with KITTI's angle of view, for any image size: fx = 721.5 px at 1240 px."""
    focal_px = 721.5 * width_px / 1240
    camera = PinholeCamera(
        focal_px, focal_px, 0.492 * width_px, 0.46 * height_px, width_px, height_px
    )
    return StereoRig.rectified(camera, baseline_m)


class Renderer:
    """Renders a scene for either camera at any time; textures are created once.

    `bodies` are the faces of each road user of the scene. `rig` is a rectified pair, whose left
    camera is the scene's; `noise_grey` is the standard deviation of the sensor noise in grey
    levels, 0 = none; `wide_lens` is the lens of both cameras whose pinholes are `rig`, None = the
    pinholes. The lens changes images only.
    """

    def __init__(
        self,
        scene: Scene,
        rig: StereoRig,
        *,
        noise_grey: float = 2.0,
        faults: Faults = NO_FAULTS,
        wide_lens: WideLens | None = None,
    ) -> None:
        if not rig.is_rectified:
            raise ValueError(
                "rig: expected a rectified pair of equal, parallel, undistorted cameras"
            )
        self.scene = scene
        self.rig = rig
        self.noise_grey = noise_grey
        self.faults = faults
        self.wide_lens = wide_lens
        self._store = TextureStore()
        rng = np.random.default_rng([scene.seed, 3])
        with ThreadPoolExecutor(1) as other:
            bodies = other.submit(lambda: [body_of(user, scene.seed) for user in scene.road_users])
            self._street = Street(rng, self._store, scene.surroundings, road=scene.road)
            self.bodies = bodies.result()
        self._surfaces: dict[int, Surface] = {}
        drawn = [
            *self.bodies,
            *(body_of_obstacle(obstacle, scene.seed) for obstacle in scene.obstacles),
        ]
        self._shadows, self._solids = (
            Crowd(
                [[face for face in body if face.is_shadow == is_shadow] for body in drawn],
                self._store,
            )
            for is_shadow in (True, False)
        )
        self._cameras = {"left": _finer(rig.left), "right": _finer(right_camera(rig.left, faults))}
        wobble = scene.wobble
        rotates = not scene.road.is_straight or any(
            (wobble.pitch_rad, wobble.roll_rad, scene.camera_pitch_rad, scene.mounting != AHEAD)
        )
        # The sky has half the resolution of the canvas, and is larger than the image if the camera
        # rotates.
        camera, (wide, high) = self._cameras["left"], SKY_SIZE if rotates else (1.0, 1.0)
        size_px = (round(wide * camera.width_px), round(high * camera.height_px))
        horizon_px = camera.cy_px + (size_px[1] - camera.height_px) / 2
        self._sky = sky_picture(
            rng, size_px=size_px, horizon_px=horizon_px, is_night=scene.is_night
        )

    def render(self, time_s: float, *, side: Side = "left") -> Image:
        """(H, W, 3) uint8 BGR image of one camera; the same scene, time and side give the same
        pixels.
        """
        return self._exposed(self._drawn(time_s, side), time_s, side)

    def render_with_depth(self, time_s: float) -> tuple[Image, FloatArray]:
        """The left image, and the exact (2 * H, 2 * W) 1/z of its samples in 1/m, 0 = sky."""
        canvas = self._drawn(time_s, "left")
        return self._exposed(canvas, time_s, "left"), np.asarray(canvas.inverse_depth)

    def render_with_labels(self, time_s: float) -> tuple[Image, FloatArray, npt.NDArray[np.uint16]]:
        """The results of `render_with_depth`, and (2 * H, 2 * W) the visible heads and number
        plates of the samples.

        A label is 2 n + part (`faces.IdentifyingPart`) for road user n, 0 = neither head nor plate.
        """
        canvas = self._drawn(time_s, "left", has_labels=True)
        return (
            self._exposed(canvas, time_s, "left"),
            np.asarray(canvas.inverse_depth),
            canvas.labels,
        )

    def drawn_owners(self, time_s: float) -> tuple[FloatArray, npt.NDArray[np.uint16]]:
        """(2 * H, 2 * W) exact 1/z of the left image's samples in 1/m, and the body that each of
        them shows.

        n + 1 is row n of the road users, followed by the obstacles; 0 = street or sky.
        """
        canvas = self._drawn(time_s, "left", has_labels=True, solids=self._solids.with_owners())
        return np.asarray(canvas.inverse_depth, np.float64), canvas.labels

    def silhouette(self, time_s: float, row: int) -> FloatArray:
        """(2 * H, 2 * W) exact 1/z in 1/m of the road user in row `row` alone in the left image, 0
        elsewhere.
        """
        canvas = Canvas(self._cameras["left"], self._store)
        poses = self.scene.location_m(time_s), self.scene.rotations(time_s)
        self._solids.draw(canvas, np.array([row]), poses, repeat(True))
        return np.asarray(canvas.inverse_depth, np.float64)

    def depth_m(self, time_s: float) -> FloatArray:
        """(H, W) exact depth of each pixel of the left image, from the mean of 1/z over its
        samples; NaN = sky.
        """
        inverse = self._in_pixels(self._drawn(time_s, "left"))
        return np.asarray(1.0 / np.where(inverse > 0, inverse, np.nan), np.float64)

    def surface(self, row: int) -> Surface:
        """The surface of the road user in row `row`, in its frame."""
        if row not in self._surfaces:
            self._surfaces[row] = Surface.of(self.bodies[row])
        return self._surfaces[row]

    def _in_pixels(self, canvas: Canvas) -> FloatArray:
        """(H, W) mean 1/z of each pixel's samples."""
        return np.asarray(
            cv2.resize(canvas.inverse_depth, _size_px(self.rig.left), interpolation=cv2.INTER_AREA)
        )

    def _shift_m(self, side: Side) -> FloatArray:
        """Position of the left camera in the frame of a camera."""
        return np.array([-self.rig.baseline_m if side == "right" else 0.0, 0.0, 0.0])

    def _exposed(self, canvas: Canvas, time_s: float, side: Side) -> Image:
        scene, faults, is_right = self.scene, self.faults, side == "right"
        samples = np.asarray(cv2.GaussianBlur(canvas.bgra, (3, 3), LENS_BLUR_SAMPLES), np.uint8)
        is_lit = scene.is_night or faults.rain > 0  # both are added to the pinhole's pixels
        if self.wide_lens is not None and not is_lit:
            beside = [self._drawn(time_s, side, view=view).bgra for view in self.wide_lens.sides]
            small = self.wide_lens.recorded(samples, beside)
        else:
            small = np.asarray(
                cv2.resize(samples, _size_px(self.rig.left), interpolation=cv2.INTER_AREA), np.uint8
            )
        image = np.asarray(cv2.cvtColor(small, cv2.COLOR_BGRA2BGR), np.uint8)
        if scene.is_night:
            camera = right_camera(self.rig.left, faults) if is_right else self.rig.left
            heads_m = self._street.roadside.lamp_heads_m(scene.ego_z_m(time_s))
            lamps = lamps_of(scene, time_s, lamp_heads_m=heads_m, shift_m=self._shift_m(side))
            image = night_image(image, self._in_pixels(canvas), camera, lamps)
        if faults.rain > 0:
            drops_seed = [scene.seed, 7, round(time_s * 1e6) % 2**32]
            image = with_rain(image, self.rig, drops_seed, rain=faults.rain, is_right=is_right)
        if self.wide_lens is not None and is_lit:
            image = self.wide_lens.recorded(image)
        return self._with_noise(with_blur_and_gain(image, faults, is_right=is_right), time_s, side)

    def _drawn(
        self,
        time_s: float,
        side: Side,
        *,
        has_labels: bool = False,
        solids: Crowd | None = None,
        view: SideView | None = None,
    ) -> Canvas:
        """The canvas with the street, the road users, the obstacles and the sky; `view`: to the
        side, None = ahead.
        """
        pose, ego_z_m = self.scene.pose(time_s), self.scene.ego_z_m(time_s)
        camera, turn = self._cameras[side], np.eye(3)
        if view is not None:
            camera, turn = _finer(view.camera), view_from_camera(view.yaw_deg)
        canvas = Canvas(camera, self._store, has_labels=has_labels)
        shift_m, rotation = turn @ self._shift_m(side), turn @ pose.camera_from_world
        street = self._street.faces(ego_z_m, math.radians(self.scene.mounting.yaw_deg))
        canvas.draw(street.rotated(rotation).moved(shift_m - rotation @ pose.position_m))
        self._draw_bodies(canvas, time_s, shift_m, solids or self._solids, turn)
        if n_rows := canvas.n_sky_rows():
            canvas.fill_sky(self._background(pose, canvas.camera, n_rows))
        return canvas

    def _draw_bodies(
        self, canvas: Canvas, time_s: float, shift_m: FloatArray, solids: Crowd, turn: FloatArray
    ) -> None:
        """Draw all bodies, whose poses are multiplied by `turn` (3, 3) and then moved by `shift_m`
        (3,).
        """
        scene = self.scene
        obstacle_location_m, obstacle_rotations = scene.obstacle_poses(time_s)
        location_m = np.concatenate([scene.location_m(time_s), obstacle_location_m]) @ turn.T
        rotations = turn @ np.concatenate([scene.rotations(time_s), obstacle_rotations])
        obstacle_size_hwl_m = np.array(
            [obstacle.size_hwl_m for obstacle in scene.obstacles]
        ).reshape(-1, 3)
        size_hwl_m = np.concatenate([scene.size_hwl_m(), obstacle_size_hwl_m])
        poses = location_m, rotations = location_m + shift_m, rotations
        in_reach = np.flatnonzero((location_m[:, 2] > -LONGEST_HALF_M) & (location_m[:, 2] < FAR_M))
        nearest_first = in_reach[np.argsort(location_m[in_reach, 2], kind="stable")]
        may_be_visible = canvas.may_be_visible(
            corners_m(location_m, size_hwl_m, rotations)[nearest_first]
        )
        # their poles are outside
        raised = {row for row, user in enumerate(scene.road_users) if user.raised_m > 0}
        is_visible = (
            box or row in raised
            for box, row in zip(may_be_visible, nearest_first.tolist(), strict=True)
        )
        # first, since shadows fall only on the road
        self._shadows.draw(canvas, nearest_first, poses, repeat(True))
        solids.draw(canvas, nearest_first, poses, is_visible)

    def _background(self, pose: CameraPose, camera: PinholeCamera, n_rows: int) -> Image:
        """The upper rows of the sky as this camera sees it, which depends on its rotation and
        principal point only.
        """
        left = self._cameras["left"]
        camera_matrix, sky_matrix = camera.matrix, left.matrix
        sky_size_px = 2 * np.array(self._sky.shape[1::-1])
        sky_matrix[:2, 2] += (sky_size_px - (camera.width_px, camera.height_px)) / 2
        # around the direction in which the camera is mounted
        turn = yaw_rotation(math.radians(self.scene.mounting.yaw_deg)) @ pose.camera_from_world.T
        to_sky = sky_matrix @ turn @ np.linalg.inv(camera_matrix)
        to_half_sky = np.linalg.inv(_FROM_HALF) @ to_sky @ _FROM_HALF
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size_px = (camera.width_px // 2, (n_rows + 1) // 2)
        warped = cv2.warpPerspective(
            self._sky, to_half_sky, size_px, flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
        whole = cv2.resize(warped, (2 * size_px[0], 2 * size_px[1]), interpolation=cv2.INTER_LINEAR)
        return np.asarray(whole[:n_rows], np.uint8)

    def _with_noise(self, image: Image, time_s: float, side: Side) -> Image:
        if self.noise_grey <= 0:
            return image
        stream = [self.scene.seed, 4, round(time_s * 1e6) % 2**32, int(side == "right")]
        random_bytes = np.frombuffer(
            np.random.default_rng(stream).bytes(image.size), np.uint8
        ).reshape(image.shape)
        steps = noise_steps(self.noise_grey).astype(np.int16)
        lighter, darker = (np.clip(sign * steps, 0, 128).astype(np.uint8) for sign in (1, -1))
        brightened = cv2.add(image, cv2.LUT(random_bytes, lighter))  # saturates, as sensors do
        return np.asarray(cv2.subtract(brightened, cv2.LUT(random_bytes, darker)), np.uint8)


@cache
def noise_steps(sigma_grey: float) -> npt.NDArray[np.int8]:
    """(256,) quantiles of the normal distribution in whole grey levels: the noise for each random
    byte.
    """
    steps = [sigma_grey * NormalDist().inv_cdf((k + 0.5) / 256) for k in range(256)]
    return np.asarray(np.clip(np.rint(steps), -128, 127), np.int8)


def _size_px(camera: PinholeCamera) -> tuple[int, int]:
    return camera.width_px, camera.height_px


def _finer(camera: PinholeCamera) -> PinholeCamera:
    """A camera with the samples as pixels: sample k of pixel u is at u + (k + 1/2) / SAMPLES -
    1/2.
    """
    return PinholeCamera(
        camera.fx_px * SAMPLES,
        camera.fy_px * SAMPLES,
        (camera.cx_px + 0.5) * SAMPLES - 0.5,
        (camera.cy_px + 0.5) * SAMPLES - 0.5,
        camera.width_px * SAMPLES,
        camera.height_px * SAMPLES,
    )


class Crowd:
    """Faces of many bodies, in the frame of each; labels are 2 n + part of body n
    (`faces.IdentifyingPart`), else 0.
    """

    def __init__(self, bodies: Sequence[Sequence[Face]], store: TextureStore) -> None:
        faces = FaceTable.of([face for body in bodies for face in body], store)
        self._n_faces = np.array([len(body) for body in bodies], np.int64)
        owner = np.repeat(np.arange(len(bodies)), self._n_faces)
        self._faces = replace(faces, label=np.where(faces.label > 0, 2 * owner + faces.label, 0))
        self._first = np.cumsum(self._n_faces) - self._n_faces

    def with_owners(self) -> Crowd:
        """The same faces with the labels n + 1 for body n."""
        owned = copy(self)
        owned._faces = replace(
            self._faces, label=1 + np.repeat(np.arange(len(self._n_faces)), self._n_faces)
        )
        return owned

    def draw(
        self,
        canvas: Canvas,
        order: IntArray,
        poses: tuple[FloatArray, FloatArray],
        is_visible: Iterable[bool],
    ) -> None:
        """Draw the bodies with the indices `order` (M,), if visible; each value is read just before
        its body is drawn.

        `poses` are (N, 3) locations of all bodies in the camera's frame, and (N, 3, 3) rotations to
        that frame.
        """
        n_faces = self._n_faces[order]
        owner, first = np.repeat(order, n_faces), np.cumsum(n_faces) - n_faces
        rows = np.arange(len(owner)) + np.repeat(self._first[order] - first, n_faces)
        table = self._faces.select(rows).rotated(poses[1][owner]).moved(poses[0][owner])
        pieces = canvas.project(table)
        starts = np.searchsorted(pieces.face, first).tolist()
        ends = np.searchsorted(pieces.face, first + n_faces).tolist()
        for start, end, is_drawn in zip(starts, ends, is_visible, strict=False):
            if start < end and is_drawn:
                canvas.paint(pieces, table, slice(start, end))
