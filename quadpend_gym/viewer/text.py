"""Text on a pygame surface."""

from typing import Any

import pygame

from quadpend_gym.viewer.palette import Colour
from quadpend_gym.viewer.primitives import Point


class TextRenderer:
    """Renders lines of text in the font that pygame ships, which looks the same on every machine."""

    def __init__(self) -> None:
        """Start with an empty cache of fonts and rendered lines."""
        pygame.font.init()
        self._fonts: dict[int, Any] = {}
        self._cache: dict[tuple[str, int, Colour], Any] = {}

    def _rendered(self, text: str, size: int, colour: Colour) -> Any:
        key = text, size, colour
        if key not in self._cache:
            if len(self._cache) > 2000:
                self._cache.clear()
            self._cache[key] = self._render(*key)
        return self._cache[key]

    def _render(self, text: str, size: int, colour: Colour) -> Any:
        try:
            return self._font(size).render(text, True, colour)
        except pygame.error:  # other code has called pygame.quit() in the meantime
            pygame.font.init()
            self._fonts.clear()
            return self._font(size).render(text, True, colour)

    def _font(self, size: int) -> Any:
        if size not in self._fonts:
            self._fonts[size] = pygame.font.Font(None, size)
        return self._fonts[size]

    def width(self, text: str, size: int) -> float:
        """Return the width of a line of text, pixels."""
        return float(self._rendered(text, size, (0, 0, 0)).get_width())

    def write(self, surface: Any, text: str, at: Point, size: int, colour: Colour, anchor: str = "topleft") -> float:
        """Write a line of text.

        Args:
            surface: Surface of pygame to write on.
            text: The line of text.
            at: Position of the anchor, pixels.
            size: Font size, pixels.
            colour: Colour of the text.
            anchor: Point of the text's rectangle that is placed at `at`, as an attribute of `pygame.Rect`.

        Returns:
            The right end of the text, pixels.
        """
        rendered = self._rendered(text, size, colour)
        box = rendered.get_rect(**{anchor: (round(at[0]), round(at[1]))})
        surface.blit(rendered, box)
        return float(box.right)
