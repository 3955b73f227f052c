"""A wheel has the three packages with their data and nothing else, and is enough to fly a controller."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZipFile

import pytest

from quadpend_gym import __version__
from tests.helpers.sources import ROOT

PACKAGES = {"quadpend_gym": ROOT, "quadpend_baselines": ROOT / "baselines", "quadpend_train": ROOT / "train"}
PAGES = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel that is built from a copy of the repository."""
    source = tmp_path_factory.mktemp("wheel") / "source"
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "runs"))
    code = "from setuptools.build_meta import build_wheel; build_wheel('..')"
    subprocess.run([sys.executable, "-c", code], cwd=source, capture_output=True, check=True)
    (path,) = source.parent.glob("*.whl")
    return path


def test_a_wheel_has_the_files_of_the_three_packages_and_no_others(wheel: Path) -> None:
    packed = set(ZipFile(wheel).namelist())
    metadata = f"quadpend_gym-{__version__}.dist-info/"
    files = [
        path.relative_to(folder).as_posix()
        for package, folder in PACKAGES.items()
        for path in (folder / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    ]
    assert {name for name in packed if not name.startswith(metadata)} == set(files)
    assert {metadata + "licenses/LICENSE", metadata + "entry_points.txt"} < packed


def test_the_description_of_a_wheel_needs_no_file(wheel: Path) -> None:
    metadata = ZipFile(wheel).read(f"quadpend_gym-{__version__}.dist-info/METADATA").decode()
    assert "Description-Content-Type: text/markdown" in metadata
    assert "# quadpend_gym" in metadata
    assert [link for link in re.findall(r"\]\(([^)]*)\)", metadata) if not link.startswith("https://")] == []


def test_the_same_version_stands_in_every_file() -> None:
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    headings = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert next(heading for heading in headings if heading != "Unreleased") == __version__
    pages = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert set(re.findall(r"quadpend_gym-([\d.]+)-py3", pages)) <= {__version__}


@pytest.mark.extras
def test_the_readme_runs_where_only_the_wheel_is_installed_and_its_commands_with_its_extras(
    wheel: Path, tmp_path: Path
) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (example,), (commands,) = (re.findall(rf"```{kind}\n(.*?)```", readme, re.DOTALL) for kind in ("python", "sh"))
    brief = {"train": "--max-seconds 5", "evaluate": "--episodes 2", "watch": "--out look.png"}
    with TemporaryDirectory() as folder:  # 2 GB, which pytest would keep
        python = Path(folder, "bin/python")

        def run(*command: str | Path) -> str:
            ran = subprocess.run([python, "-I", *command], cwd=tmp_path, capture_output=True, text=True, check=False)
            assert ran.returncode == 0, ran.stderr
            return ran.stdout

        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        run("-m", "pip", "install", "--quiet", wheel)
        printed = run("-c", f"{example}\nprint(quadpend_gym.__file__)")
        assert re.search(rf"error after 12 s: \[.*\] mm\n{re.escape(folder)}", printed)
        run("-m", "pip", "install", "--quiet", "--constraint", ROOT / "constraints.txt", f"{wheel}[train,view]")
        for line in commands.splitlines():
            _, command, *options = shlex.split(line)
            run("-m", "quadpend_train", command, *options, *shlex.split(brief[command]))
    assert (tmp_path / "look.png").stat().st_size > 10_000
    assert (tmp_path / "results/report.html").exists()
