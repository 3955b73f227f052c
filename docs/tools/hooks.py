"""Hooks of MkDocs: pages of the site that are made from files outside `docs/`.

A link from a page to a source file becomes a link to a page with that source, so the site needs no server of the
repository. The files in `PAGES` become pages too. The links on disk stay as they are and work on any host of the
repository.
"""

import base64
import json
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs/tour.ipynb"
# Pages of the site that are made from files of other names, by the paths of these files
PAGES = {"CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md", "docs/tour.ipynb": "tour.md"}
LINK = re.compile(r"(\]\(|^\[[^\]]+\]: )((?:\.\./|docs/|tests/|tour\.ipynb)[^)#\s]*)", re.MULTILINE)
LABEL = re.compile(r"^\[(`[^\]]+`)\]: (\S+)$", re.MULTILINE)
SHORTCUT = re.compile(r"\[(`[^\]]+`)\](?![:(\[])")
LANGUAGES = {".py": "python", ".toml": "toml", ".yml": "yaml", ".json": "json", ".md": "markdown", "": "makefile"}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of `PAGES`, and one for every source file that a page links to."""
    for source in ("CHANGELOG.md", "CONTRIBUTING.md"):
        files.append(File.generated(config, PAGES[source], content=(ROOT / source).read_text(encoding="utf-8")))
    text, pictures = notebook_page(json.loads(NOTEBOOK.read_text(encoding="utf-8")))
    files.append(File.generated(config, "tour.md", content=text))
    for name, picture in pictures.items():
        files.append(File.generated(config, f"tour/{name}", content=picture))
    linked = {
        target
        for file in files.documentation_pages()
        for _, link in LINK.findall(file.content_string)
        if _is_source(target := _target(file.src_uri, link))
    }
    for path in sorted(linked):
        files.append(File.generated(config, f"source/{path}.md", content=_source_page(ROOT / path, path)))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Replace links that leave `docs/` by links to the pages of `on_files`, and write out links with code as label."""
    markdown = LINK.sub(lambda match: match[1] + _site_link(page.file.src_uri, match[2]), markdown)
    if page.file.src_uri == "index.md":
        page.meta["hide"] = ["navigation", "toc"]  # room for the flying page
    targets = dict(LABEL.findall(markdown))  # Python-Markdown does not resolve labels in backticks
    return SHORTCUT.sub(
        lambda match: f"[{match[1]}]({targets[match[1]]})" if match[1] in targets else match[0], markdown
    )


def _target(uri: str, link: str) -> str:
    """Return the path from the root of the repository to the target of a link on the page `uri`."""
    source = next((path for path, name in PAGES.items() if name == uri), f"docs/{uri}")
    return posixpath.normpath(posixpath.join(posixpath.dirname(source), link))


def _is_source(path: str) -> bool:
    return not path.startswith("docs/") and path not in PAGES and (ROOT / path).is_file()


def _site_link(uri: str, link: str) -> str:
    target = _target(uri, link)
    target = f"source/{target}.md" if _is_source(target) else PAGES.get(target, target.removeprefix("docs/"))
    return posixpath.relpath(target, posixpath.dirname(uri) or ".")


def _source_page(file: Path, path: str) -> str:
    language = LANGUAGES.get(file.suffix, "text")
    text = file.read_text(encoding="utf-8")
    head = f"---\nsearch:\n  exclude: true\nhide: [toc]\n---\n\n# `{file.name}`\n\n`{path}`\n\n"
    return f'{head}`````{language} linenums="1"\n{text}\n`````\n'


def notebook_page(notebook: dict[str, Any]) -> tuple[str, dict[str, bytes]]:
    """Return a notebook as Markdown, and its pictures by name. A printed Markdown table becomes a table."""
    parts, pictures = [], {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", ()):
            if "text" in output:
                text = "".join(output["text"]).strip()
                parts.append(text if text.startswith("| ") else f"```text\n{text}\n```")
            elif "image/png" in output.get("data", {}):
                name = f"{cell['id']}.png"
                pictures[name] = base64.b64decode("".join(output["data"]["image/png"]))
                parts.append(f"![Picture made by the cell above](tour/{name})")
    return "\n\n".join(parts) + "\n", pictures
