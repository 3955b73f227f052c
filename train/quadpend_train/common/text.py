"""Messages of other libraries, for the terminal."""

_LONGEST = 200  # characters of a message of another library


def brief(error: object, longest: int = _LONGEST) -> str:
    """Return the message of an exception in one line without control characters, with `longest` characters at most.

    Messages about a damaged file can contain its bytes.
    """
    text = " ".join("".join(c if c.isprintable() or c.isspace() else "?" for c in str(error)).split())
    return text if len(text) <= longest else f"{text[: longest - 2].rstrip()} …"
