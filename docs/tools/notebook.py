"""Run `docs/tour.py` as a notebook and write `docs/tour.ipynb` with its outputs: ``python -m docs.tools.notebook``."""

import re
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

DOCS = Path(__file__).parents[1]
TOUR, NOTEBOOK = DOCS / "tour.py", DOCS / "tour.ipynb"


def cells(text: str) -> list[Any]:
    """Return the cells of a script in the percent format; the title of a cell of code becomes a heading."""
    made = []
    for part in re.split(r"^# %% ", text, flags=re.MULTILINE)[1:]:
        title, _, body = part.partition("\n")
        if title == "[markdown]":
            made.append(nbformat.v4.new_markdown_cell(re.sub(r"^# ?", "", body, flags=re.MULTILINE).strip()))
        else:
            made.append(nbformat.v4.new_markdown_cell(f"## {title}"))
            made.append(nbformat.v4.new_code_cell(body.strip()))
    for number, cell in enumerate(made):
        cell["id"] = f"cell-{number}"  # random ids would change the file at every run
    return made


def run(notebook: Any) -> None:
    """Run a notebook in an empty folder and drop what changes from run to run or is only for a terminal."""
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(notebook, timeout=600, resources={"metadata": {"path": folder}}).execute()
    for cell in notebook.cells:
        cell.metadata.clear()
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
            for output in cell.outputs:
                output.get("data", {}).pop("image/jpeg", None)  # the same picture as the PNG


if __name__ == "__main__":
    document = nbformat.v4.new_notebook(cells=cells(TOUR.read_text(encoding="utf-8")))
    run(document)
    document.metadata = {"kernelspec": {"name": "python3", "display_name": "Python 3"}}
    nbformat.write(document, NOTEBOOK)
    print(f"{NOTEBOOK.name}: {NOTEBOOK.stat().st_size / 1000:.0f} kB")
