"""Pictures of the environments, drawn with pygame-ce.

`snapshot` has the data of a picture, `picture` draws snapshots, and `window` shows them in real time. Importing this
package does not import pygame.
"""

from gymnasium.error import DependencyNotInstalled


def check_pygame() -> None:
    """Raise DependencyNotInstalled if pygame is missing, or is not pygame-ce."""
    try:
        from pygame.draw import aacircle  # noqa: F401  # only pygame-ce has this function
    except ImportError as error:
        raise DependencyNotInstalled("pictures need pygame-ce: pip install 'quadpend-gym[view]'") from error
