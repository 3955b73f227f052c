"""Names of scenarios in messages."""

_MOST = 60  # characters


def short_name(name: str) -> str:
    """Return the name of a scenario, or its beginning if it is long, as that of a scenario given as JSON is."""
    return name if len(name) <= _MOST else f"{name[: _MOST - 1]}…"
