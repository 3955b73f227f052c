"""Largest numbers of episodes, processes and so on: a typing error must not use up the memory or the year."""

from typing import Any, NamedTuple

from quadpend_gym.core.validation import check_int


class Limit(NamedTuple):
    """Smallest and largest permitted value, and the reason for the largest."""

    least: int
    most: int
    reason: str


_EPISODES = "an episode of 10 s needs 8 kB of memory for each policy"
_LIMITS = {
    "episodes": Limit(1, 100_000, _EPISODES),
    "robustness": Limit(0, 100_000, _EPISODES),
    "replay": Limit(0, 1000, "an episode adds 50 kB to the page for each policy"),
    "jobs": Limit(1, 1024, "each process needs 0.3 GB of memory"),
    "trials": Limit(1, 1_000_000, "each takes seconds"),
    "seeds": Limit(1, 1000, "each is a training of minutes"),
    "seed": Limit(0, 2**62, "the seeds of all episodes must be integers of 64 bits"),
}


def check_counts(**values: Any) -> None:
    """Check numbers with the names of options, such as ``episodes=100``.

    Raises:
        ValueError: If one is not a whole number in its range.
    """
    for name, value in values.items():
        least, most, reason = _LIMITS[name]
        try:
            check_int(value, name, least, most)
        except ValueError as error:
            too_large = isinstance(value, int) and value > most
            raise ValueError(f"{error}{f': {reason}' if too_large else ''}") from error
