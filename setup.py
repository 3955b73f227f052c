"""The description of a package on an index: the README without links to files and pictures, which an index lacks."""

import re
from pathlib import Path

from setuptools import setup

README = Path("README.md").read_text(encoding="utf-8")
WITHOUT_PICTURES = re.sub(r"!\[[^]]*\]\((?!https?:)[^)]*\)\n+", "", README)
setup(
    long_description=re.sub(r"\[([^]]*)\]\((?!https?:)[^)]*\)", r"\1", WITHOUT_PICTURES),
    long_description_content_type="text/markdown",
)
