"""Pictures of a world: `film` keeps what is to be seen, `picture` and `window` show it with pygame-ce.

Nothing here imports pygame before the first picture is asked for.
"""

from gymnasium.error import DependencyNotInstalled


def check_pygame() -> None:
    """Raise DependencyNotInstalled unless there is a pygame that can draw what we want."""
    try:
        from pygame.draw import aacircle  # noqa: F401  # which pygame has not, only pygame-ce
    except ImportError as error:
        raise DependencyNotInstalled("pictures need pygame-ce: pip install 'quadpend-gym[view]'") from error
