"""Heavy libraries load late; `lint-imports` checks which package may import which, see pyproject.toml."""

import subprocess
import sys

from tests.helpers.sources import HEAVY, ROOT


def test_importing_the_environment_loads_no_heavy_library() -> None:
    code = "import sys, quadpend_gym, quadpend_gym.wrappers; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not HEAVY & set(ran.stdout.split())
