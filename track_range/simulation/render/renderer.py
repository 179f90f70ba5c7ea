"""One eye's image of a scene, at any time; the canvas draws it with 2 x 2 samples per pixel (`canvas.py`).

faces of street and road users -> canvas -> lens -> headlights, at night -> faults -> sensor noise
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import repeat
from statistics import NormalDist
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.camera.faults import NO_FAULTS, Faults, rained
from track_range.simulation.render.canvas import Canvas
from track_range.simulation.render.crowd import Crowd
from track_range.simulation.render.night import lamps_of, lit
from track_range.simulation.render.street import FAR_M, Street
from track_range.simulation.render.surface import Surface
from track_range.simulation.render.texture_store import TextureStore
from track_range.simulation.world.bodies import body_of
from track_range.simulation.world.road_shape import CameraPose
from track_range.simulation.world.scene import Scene
from track_range.simulation.world.scenery import sky_picture
from track_range.simulation.world.truth import corners_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

Side = Literal["left", "right"]

SAMPLES = 2
"""Per pixel and axis."""

LONGEST_HALF_M = 8.0
"""No body reaches farther than this towards the camera from its centre."""

LENS_BLUR_SAMPLES = 0.8
"""Standard deviation of the lens's blur, about 0.4 px; a lens without any would show detail finer than its pixels."""

NOISE_GREY = 2.0
"""Standard deviation of the sensor's noise, grey levels."""

SKY_SIZE = (1.7, 1.5)
"""Width and height of the sky's picture, in images: for a camera that turns."""


def kitti_like_rig(*, width_px: int = 1240, height_px: int = 376, baseline_m: float = 0.54) -> StereoRig:
    """A rectified pair with KITTI's angle of view, for any image size: fx = 721.5 px at 1240 px."""
    focal_px = 721.5 * width_px / 1240
    camera = PinholeCamera(focal_px, focal_px, 0.492 * width_px, 0.46 * height_px, width_px, height_px)
    return StereoRig.rectified(camera, baseline_m)


_FROM_HALF = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]])
"""Pixels of a picture of half the size -> pixels."""


class Renderer:
    """Draws a scene for either eye at any time; textures are made once, and the scene is never changed.

    Args:
        scene: what there is to see.
        rig: a rectified pair; the left eye is the scene's camera.
        noise_grey: standard deviation of the sensor noise in grey levels, 0 = none.
        faults: of the cameras.

    Attributes:
        bodies: each road user's faces in its own axes.
    """

    def __init__(
        self, scene: Scene, rig: StereoRig, *, noise_grey: float = NOISE_GREY, faults: Faults = NO_FAULTS
    ) -> None:
        if not rig.is_rectified:
            raise ValueError("the simulation draws rectified pairs: equal, parallel, undistorted cameras wanted")
        self.scene = scene
        self.rig = rig
        self.noise_grey = noise_grey
        self.faults = faults
        self._store = TextureStore()
        rng = np.random.default_rng([scene.seed, 3])
        with ThreadPoolExecutor(1) as other:
            bodies = other.submit(lambda: [body_of(user, scene.seed) for user in scene.road_users])
            self._street = Street(rng, self._store, scene.surroundings, road=scene.road)
            self.bodies = bodies.result()
        self._surfaces: dict[int, Surface] = {}
        self._shadows, self._solids = (
            Crowd([[face for face in body if face.is_shadow == is_shadow] for body in self.bodies], self._store)
            for is_shadow in (True, False)
        )
        self._cameras = {"left": _finer(rig.left), "right": _finer(faults.right_camera(rig.left))}
        self._turns = not scene.road.is_straight or scene.wobble.pitch_rad > 0 or scene.wobble.roll_rad > 0
        self._sky = self._sky_picture(rng)

    def render(self, time_s: float, *, side: Side = "left") -> Image:
        """(H, W, 3) uint8 BGR; the same scene, time and eye give the same pixels."""
        return self._exposed(self._drawn(time_s, side), time_s, side)

    def render_with_depth(self, time_s: float) -> tuple[Image, FloatArray]:
        """The left eye's image, and (2 H, 2 W) the exact 1/z of its samples, 0 = sky, from one drawing."""
        canvas = self._drawn(time_s, "left")
        return self._exposed(canvas, time_s, "left"), np.asarray(canvas.inverse_depth)

    def depth_m(self, time_s: float, *, side: Side = "left") -> FloatArray:
        """(H, W) exact z of what each pixel shows, the mean in 1/z over its samples; NaN = sky."""
        inverse = self._in_pixels(self._drawn(time_s, side))
        return np.asarray(1.0 / np.where(inverse > 0, inverse, np.nan), np.float64)

    def surface(self, row: int) -> Surface:
        """What a ray can meet of a road user, in its own axes."""
        if row not in self._surfaces:
            self._surfaces[row] = Surface.of(self.bodies[row])
        return self._surfaces[row]

    @property
    def _size_px(self) -> tuple[int, int]:
        return self.rig.left.width_px, self.rig.left.height_px

    def _in_pixels(self, canvas: Canvas) -> FloatArray:
        """(H, W) mean 1/z of each pixel's samples."""
        return np.asarray(cv2.resize(canvas.inverse_depth, self._size_px, interpolation=cv2.INTER_AREA))

    def _exposed(self, canvas: Canvas, time_s: float, side: Side) -> Image:
        """What lens, sensor and their faults make of a drawing."""
        lens = cv2.GaussianBlur(canvas.bgra, (3, 3), LENS_BLUR_SAMPLES)
        small = cv2.resize(lens, self._size_px, interpolation=cv2.INTER_AREA)
        image = np.asarray(cv2.cvtColor(small, cv2.COLOR_BGRA2BGR), np.uint8)
        if self.scene.is_night:
            camera = self.rig.left if side == "left" else self.faults.right_camera(self.rig.left)
            lamps = lamps_of(self.scene, time_s, lamp_heads_m=self._street.lamp_heads_m(self.scene.ego_z_m(time_s)))
            shift_m = np.array([-self.rig.baseline_m if side == "right" else 0.0, 0.0, 0.0])
            image = lit(image, self._in_pixels(canvas), camera, lamps.moved(shift_m))
        if self.faults.rain > 0:
            image = rained(image, self.rig, [self.scene.seed, 7, round(time_s * 1e6) % 2**32], (self.faults.rain, side))
        return self._with_noise(self.faults.seen(image, is_right=side == "right"), time_s, side)

    def _drawn(self, time_s: float, side: Side) -> Canvas:
        pose = self.scene.pose(time_s)
        canvas = Canvas(self._cameras[side], self._store)
        shift_m = np.array([-self.rig.baseline_m if side == "right" else 0.0, 0.0, 0.0])
        turn = pose.camera_from_world
        street = self._street.faces(self.scene.ego_z_m(time_s))
        canvas.draw(street.turned(turn).moved(shift_m - turn @ pose.place_m))
        self._draw_road_users(canvas, time_s, shift_m)
        if n_rows := canvas.sky_until():
            canvas.fill_sky(self._background(pose, canvas.camera, n_rows))
        return canvas

    def _draw_road_users(self, canvas: Canvas, time_s: float, shift_m: FloatArray) -> None:
        places_m, turns = self.scene.location_m(time_s) + shift_m, self.scene.turns(time_s)
        in_reach = np.flatnonzero((places_m[:, 2] > -LONGEST_HALF_M) & (places_m[:, 2] < FAR_M))
        nearest_first = in_reach[np.argsort(places_m[in_reach, 2], kind="stable")]
        boxes_m = corners_m(places_m, self.scene.size_hwl_m(), turns)[nearest_first]
        could_show = canvas.could_show(boxes_m)
        stands_on_pole = [self.scene.road_users[row].raised_m > 0 for row in nearest_first.tolist()]
        shown = (could or poled for could, poled in zip(could_show, stands_on_pole, strict=True))
        self._shadows.draw(canvas, nearest_first, (places_m, turns), repeat(True))  # these lie on the road alone
        self._solids.draw(canvas, nearest_first, (places_m, turns), shown)

    def _sky_picture(self, rng: np.random.Generator) -> Image:
        """Half as many samples as the canvas has, either way, or more where the camera turns."""
        wide, high = SKY_SIZE if self._turns else (1.0, 1.0)
        camera = self._cameras["left"]
        size_px = (round(wide * camera.width_px), round(high * camera.height_px))
        horizon_px = camera.cy_px + (size_px[1] - camera.height_px) / 2
        return sky_picture(rng, size_px=size_px, horizon_px=horizon_px, is_night=self.scene.is_night)

    def _background(self, pose: CameraPose, camera: PinholeCamera, n_rows: int) -> Image:
        """The upper rows of the sky as this camera sees it: only its turn, and the place of its centre, count."""
        left = self._cameras["left"]
        at_px, of_sky_px = camera.matrix, left.matrix
        sky_size_px = 2 * np.array(self._sky.shape[1::-1])
        of_sky_px[:2, 2] += (sky_size_px - (camera.width_px, camera.height_px)) / 2
        to_sky = of_sky_px @ pose.camera_from_world.T @ np.linalg.inv(at_px)
        to_half_sky = np.linalg.inv(_FROM_HALF) @ to_sky @ _FROM_HALF
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size_px = (camera.width_px // 2, (n_rows + 1) // 2)
        turned = cv2.warpPerspective(self._sky, to_half_sky, size_px, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        whole = cv2.resize(turned, (2 * size_px[0], 2 * size_px[1]), interpolation=cv2.INTER_LINEAR)
        return np.asarray(whole[:n_rows], np.uint8)

    def _with_noise(self, image: Image, time_s: float, side: Side) -> Image:
        if self.noise_grey <= 0:
            return image
        stream = [self.scene.seed, 4, round(time_s * 1e6) % 2**32, int(side == "right")]
        drawn = np.frombuffer(np.random.default_rng(stream).bytes(image.size), np.uint8).reshape(image.shape)
        steps = noise_steps(self.noise_grey).astype(np.int16)
        lighter, darker = (np.clip(sign * steps, 0, 128).astype(np.uint8) for sign in (1, -1))
        brightened = cv2.add(image, cv2.LUT(drawn, lighter))  # saturates, as sensors do
        return np.asarray(cv2.subtract(brightened, cv2.LUT(drawn, darker)), np.uint8)


@cache
def noise_steps(sigma_grey: float) -> npt.NDArray[np.int8]:
    """(256,) whole grey levels, each as likely: a byte's worth of the normal distribution."""
    steps = [sigma_grey * NormalDist().inv_cdf((k + 0.5) / 256) for k in range(256)]
    return np.asarray(np.clip(np.rint(steps), -128, 127), np.int8)


def render(scene: Scene, time_s: float, *, rig: StereoRig, side: Side = "left") -> Image:
    """(H, W, 3) uint8 BGR image of one eye; for more than one, a `Renderer` makes the textures only once."""
    return Renderer(scene, rig).render(time_s, side=side)


def _finer(camera: PinholeCamera) -> PinholeCamera:
    """The camera whose pixels are the samples: sample k of pixel u lies at u + (k + 1/2) / SAMPLES - 1/2."""
    return PinholeCamera(
        camera.fx_px * SAMPLES,
        camera.fy_px * SAMPLES,
        (camera.cx_px + 0.5) * SAMPLES - 0.5,
        (camera.cy_px + 0.5) * SAMPLES - 0.5,
        camera.width_px * SAMPLES,
        camera.height_px * SAMPLES,
    )
