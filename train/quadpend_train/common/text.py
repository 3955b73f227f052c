"""Text from elsewhere, such as names and messages of other libraries, for terminals, figures and Markdown."""

import codecs
import re
import sys
import unicodedata

_LONGEST = 200  # characters of a message of another library
_PLAIN = {
    "–": "-",
    "−": "-",
    "—": "-",
    "·": "*",
    "•": "*",
    "×": "x",
    "→": "->",
    "≤": "<=",
    "≥": ">=",
    "±": "+-",
    "…": "...",
}
_HANDLER = "quadpend-plain"


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


def print_everywhere() -> None:
    """Let output in an encoding that lacks a character, such as ASCII, have a similar one, or else a question mark."""
    codecs.register_error(_HANDLER, _similar)
    for stream in (sys.stdout, sys.stderr):
        encoding = (getattr(stream, "encoding", None) or "utf-8").lower().replace("-", "")
        if hasattr(stream, "reconfigure") and not encoding.startswith("utf"):
            stream.reconfigure(errors=_HANDLER)


def _similar(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_ascii, error.object[error.start : error.end])), error.end


def _ascii(character: str) -> str:
    """Return ASCII characters that look like a character, such as e for é."""
    simple = unicodedata.normalize("NFKD", _PLAIN.get(character, character)).encode("ascii", "ignore").decode()
    return simple or "?"
