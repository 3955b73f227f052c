"""Text on a pygame surface."""

from typing import Any

import pygame

from quadpend_gym.viewer.palette import Colour
from quadpend_gym.viewer.primitives import Point


class TextRenderer:
    """Text in pygame's own font, so that it looks the same everywhere."""

    def __init__(self) -> None:
        """Nothing is written yet."""
        pygame.font.init()
        self._fonts: dict[int, Any] = {}
        self._written: dict[tuple[str, int, Colour], Any] = {}

    def _picture(self, text: str, size: int, colour: Colour) -> Any:
        key = text, size, colour
        if key not in self._written:
            if len(self._written) > 2000:
                self._written.clear()
            self._written[key] = self._render(*key)
        return self._written[key]

    def _render(self, text: str, size: int, colour: Colour) -> Any:
        try:
            return self._font(size).render(text, True, colour)
        except pygame.error:  # somebody else has quit pygame since
            pygame.font.init()
            self._fonts.clear()
            return self._font(size).render(text, True, colour)

    def _font(self, size: int) -> Any:
        if size not in self._fonts:
            self._fonts[size] = pygame.font.Font(None, size)
        return self._fonts[size]

    def width(self, text: str, size: int) -> float:
        """Of a line of text, pixels."""
        return float(self._picture(text, size, (0, 0, 0)).get_width())

    def write(self, surface: Any, text: str, at: Point, size: int, colour: Colour, anchor: str = "topleft") -> float:
        """Write a line of text, and say where it ends; `anchor` is what of its box is put there, as pygame calls it."""
        picture = self._picture(text, size, colour)
        box = picture.get_rect(**{anchor: (round(at[0]), round(at[1]))})
        surface.blit(picture, box)
        return float(box.right)
