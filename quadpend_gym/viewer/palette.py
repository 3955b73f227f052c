"""Colours of the pictures.

The colours that carry a meaning can be distinguished by readers with a colour vision deficiency. Most of them are those
of Okabe and Ito.
"""

Colour = tuple[int, int, int]

SKY, GROUND, GRID, SHADOW = (215, 229, 240), (228, 231, 228), (165, 173, 170), (120, 126, 124)
INK, GREY, WHITE = (38, 42, 48), (120, 128, 138), (255, 255, 255)
BODY, ARM = (38, 42, 48), (70, 76, 84)
BLUE, VERMILLION, GREEN = (0, 114, 178), (213, 94, 0), (0, 158, 115)
ORANGE = (230, 159, 0)
VIOLET, BROWN = (130, 30, 210), (110, 45, 20)
REFERENCE, BOB, WIND, ROTOR, FRONT = BLUE, VERMILLION, GREEN, GREY, ORANGE


def blend(first: Colour, second: Colour, fraction: float) -> Colour:
    """Return the mixture of 1 − `fraction` parts of `first` and `fraction` parts of `second`."""
    r, g, b = (round(a + fraction * (b - a)) for a, b in zip(first, second, strict=True))
    return r, g, b
