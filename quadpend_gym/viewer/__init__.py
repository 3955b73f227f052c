"""Pictures of a world, drawn by pygame-ce: nothing here is imported before the first picture is asked for."""

try:
    from pygame.draw import aacircle  # noqa: F401  # which pygame itself has not
except ImportError as error:
    from gymnasium.error import DependencyNotInstalled

    raise DependencyNotInstalled("pictures need pygame-ce: pip install 'quadpend-gym[view]'") from error

from quadpend_gym.viewer.camera import Camera
from quadpend_gym.viewer.picture import Picture
from quadpend_gym.viewer.viewer import Viewer

__all__ = ["Camera", "Picture", "Viewer"]
