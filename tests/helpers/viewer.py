"""What the tests of the pictures share: a scene by hand, a projection of their own, colours, a clock and keys."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pygame
from scipy.spatial.transform import Rotation

from quadpend_gym import Reference, State
from quadpend_gym.core.arrays import Booleans, Bytes, Floats
from quadpend_gym.viewer import scene
from quadpend_gym.viewer.camera import Camera
from quadpend_gym.viewer.picture import Picture, surface_to_array
from quadpend_gym.viewer.snapshot import Snapshot
from quadpend_gym.viewer.text import TextRenderer
from tests.helpers.envs import AT_REST

SIZE = (640, 480)


def assert_picture(picture: Any) -> None:
    """It is what every picture is, and not of one colour."""
    assert isinstance(picture, np.ndarray)
    assert (picture.shape, picture.dtype) == ((480, 640, 3), np.uint8)
    assert picture.flags.c_contiguous
    assert picture.flags.owndata
    assert picture.std() > 5.0


def still(**fields: Any) -> Snapshot:
    """A snapshot of hovering at rest at the point that `Reference.hover()` names, but for some fields of the state."""
    state = State(np.concatenate([fields.get(name, value) for name, value in AT_REST.items()]).astype(float))
    return Snapshot(
        time=0.0,
        state=state,
        rod_length=0.3,
        reference=Reference.hover(),
        disturbance=np.zeros(9),
        thrust=1.0,
        error=0.0,
        tilt=float(state.alpha),
        tilt_limit=np.pi / 3,
        episode_return=0.0,
        focus=state.position.copy(),
        trail=(state.position + 0.3 * state.direction)[np.newaxis],
        streak_offset=np.zeros(3),
        rotor_angle=0.0,
    )


def blown(*force: float) -> Snapshot:
    """A snapshot in a wind of this force on the quadrotor, N."""
    return still()._replace(disturbance=np.array([*force, *np.zeros(6)]))


def drawn(seen: Snapshot, camera: Camera | None = None, size: tuple[int, int] = SIZE) -> Bytes:
    """The whole picture of a snapshot."""
    surface = pygame.Surface(size)
    Picture(camera).draw(surface, seen)
    return surface_to_array(surface)


def painted(seen: Snapshot, camera: Camera, at: Floats | tuple[float, ...]) -> Bytes:
    """The scene alone, without gauges, as a camera sees it that looks at a point."""
    surface = pygame.Surface(SIZE)
    scene.draw(surface, camera.view(np.asarray(at, float), *SIZE), scene.Backdrop(), seen)
    return surface_to_array(surface)


def projected(camera: Camera, at: Any, points: Any) -> Floats:
    """Pixels and depth of points, shape (n, 3), by a rotation that turns a camera on the x axis into its place."""
    turn = Rotation.from_euler("ZY", [camera.azimuth, -camera.elevation])
    x, y, z = turn.inv().apply(np.asarray(points, float) - at).T
    depth = camera.distance - x
    focal = SIZE[1] / 2 / np.tan(camera.field_of_view / 2)
    return np.column_stack([SIZE[0] / 2 + focal * y / depth, SIZE[1] / 2 - focal * z / depth, depth])


def like(pixels: Bytes, colour: tuple[int, int, int], tolerance: int = 12) -> Booleans:
    """Where a picture has nearly this colour, shape (height, width)."""
    return np.asarray((np.abs(pixels.astype(int) - colour) <= tolerance).all(axis=-1))


def projected_metre(camera: Camera, place: Any) -> float:
    """Pixels of a metre across at the depth of a projected point."""
    return float(SIZE[1] / 2 / np.tan(camera.field_of_view / 2) / place[2])


def greenish(pixels: Any) -> Any:
    """Where the wind is, however faint."""
    red, green, blue = np.moveaxis(pixels.astype(int), -1, 0)
    return (green - red > 15) & (green >= blue)


def middle(mask: Booleans) -> Floats:
    """Mean place of what is true, pixels to the right and down, shape (2,)."""
    assert mask.any(), "there is no such colour"
    return np.asarray(np.argwhere(mask).mean(axis=0)[::-1])


def extent(mask: Booleans) -> Floats:
    """Width and height of what is true, pixels, shape (2,)."""
    return np.asarray(np.ptp(np.argwhere(mask), axis=0)[::-1])


class Words(TextRenderer):
    """Letters that remember what was written, how large and where."""

    def __init__(self) -> None:
        super().__init__()
        self.written: dict[str, tuple[int, Any]] = {}

    def write(self, surface: Any, text: str, at: Any, size: int, colour: Any, anchor: str = "topleft") -> float:
        box = pygame.Rect((0, 0), pygame.font.Font(None, size).size(text))
        setattr(box, anchor, (round(at[0]), round(at[1])))
        self.written[text] = size, box
        return super().write(surface, text, at, size, colour, anchor)


class Clock:
    """A time that passes only while somebody sleeps or draws, with keys pressed at given times; stands for `time`."""

    def __init__(self) -> None:
        self.now = 0.0
        self.drawing = 0.0  # s, that a picture takes
        self.shown: list[float] = []  # when a picture was
        self._keys: list[tuple[float, Any]] = []

    def press(self, at: float, *keys: int) -> None:
        """Keys to be pressed at a time, s from now."""
        self._keys += [(self.now + at, pygame.event.Event(pygame.KEYDOWN, key=key)) for key in keys]

    def post(self, at: float, event: Any) -> None:
        """Any event to come at a time, s from now."""
        self._keys.append((self.now + at, event))

    def perf_counter(self) -> float:
        """The time."""
        assert self.now < 100.0, "waits for ever"
        return self.now

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.now += seconds

    def events(self) -> list[Any]:
        """What has come since the last call; instead of `pygame.event.get`."""
        come = [event for time, event in self._keys if time <= self.now]
        self._keys = [(time, event) for time, event in self._keys if time > self.now]
        return come

    def flip(self) -> None:
        """Show a picture; instead of `pygame.display.flip`."""
        self.now += self.drawing
        self.shown.append(self.now)


def lasted(clock: Clock, call: Callable[[], Any]) -> float:
    """How long a call takes by this clock, s."""
    began = clock.now
    call()
    return clock.now - began


# Machado, Oliveira and Fernandes: A physiologically-based model for simulation of color vision deficiency,
# IEEE Transactions on Visualization and Computer Graphics 15 (2009), severity 1, for linear RGB.
COLOUR_VISION: dict[str, Sequence[Sequence[float]]] = {
    "normal": np.eye(3).tolist(),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
# Of linear sRGB under D65, IEC 61966-2-1.
_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def lab(colour: tuple[int, int, int], vision: str = "normal") -> Floats:
    """CIELAB coordinates of what somebody with this colour vision sees, shape (3,)."""
    c = np.asarray(colour) / 255.0
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.asarray(COLOUR_VISION[vision]) @ linear, 0.0, 1.0)
    xyz = _XYZ @ seen / _XYZ.sum(axis=1)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])
