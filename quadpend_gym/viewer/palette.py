"""Colours; those that tell things apart, most of them Okabe and Ito's, are distinguishable by the colour-blind."""

Colour = tuple[int, int, int]

SKY, HORIZON = (190, 213, 232), (240, 244, 247)
GROUND_FAR, GROUND_NEAR, GRID, SHADOW = (236, 238, 236), (219, 223, 220), (165, 173, 170), (120, 126, 124)
INK, FAINT, PAPER = (38, 42, 48), (120, 128, 138), (255, 255, 255)
BODY, ARM = (38, 42, 48), (70, 76, 84)
BLUE, VERMILLION, GREEN = (0, 114, 178), (213, 94, 0), (0, 158, 115)
ORANGE, SKY_BLUE = (230, 159, 0), (86, 180, 233)
VIOLET, BROWN = (130, 30, 210), (110, 45, 20)
REFERENCE, BOB, WIND, ROTOR, FRONT = BLUE, VERMILLION, GREEN, FAINT, ORANGE
TELLING = (BLUE, VERMILLION, GREEN, ORANGE, SKY_BLUE, VIOLET, BROWN, INK, FAINT, PAPER)  # what a film must not lose


def mixed(one: Colour, other: Colour, share: float) -> Colour:
    """`one` with a share of `other`."""
    r, g, b = (round(a + share * (b - a)) for a, b in zip(one, other, strict=True))
    return r, g, b
