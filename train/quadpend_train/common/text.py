"""Text from elsewhere, such as names and messages of other libraries, for terminals, figures and Markdown."""

import re

_LONGEST = 200  # characters of a message of another library


def brief(error: object, longest: int = _LONGEST) -> str:
    """Return the message of an exception in one line without control characters, with `longest` characters at most.

    Messages about a damaged file can contain its bytes.
    """
    text = " ".join("".join(c if c.isprintable() or c.isspace() else "?" for c in str(error)).split())
    return text if len(text) <= longest else f"{text[: longest - 2].rstrip()} …"


def markdown_text(text: str) -> str:
    """Return a text of one line in which bars, dollar signs and HTML have no meaning, for tables and paragraphs."""
    return re.sub(r"([<|$])", r"\\\1", " ".join(text.split()))


def figure_text(text: str) -> str:
    """Return a text that Matplotlib draws as it is, although dollar signs enclose formulas."""
    return text.replace("$", r"\$")
