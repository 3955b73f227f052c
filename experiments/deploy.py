"""Policies as C on an emulated STM32F405 (Cortex-M4F), and in flight: docs/deploy.md.

    python -m experiments.deploy                 # golden vectors and the chip
    python -m experiments.deploy --episodes 200  # flights: single precision in C beside Python, seeds from 1000000

It needs gcc and, for the chip, Debian's gcc-arm-none-eabi and qemu-system-arm.
"""

import argparse
import re
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from shutil import which
from typing import NamedTuple

import numpy as np

from experiments.pages import DOCS, fill, made_by
from quadpend_gym.scenarios import find_scenarios
from quadpend_train.evaluation.episodes import TEST_SEED, run_episodes
from quadpend_train.evaluation.formatting import markdown_table
from quadpend_train.export.to_c import export_c
from quadpend_train.policies.loading import load_policy

POLICIES = {
    "flight_breeze": (
        "lqg",
        "lqr",
        "lqi",
        "flatness",
        "dual-mode",
        "adrc-paper",
        "ppo-flight-0",
        "apg-flight-0",
        "lab-0",
    ),
    "windy": ("apg-0", "ppo-alone-0", "adrc-paper"),
}
_CHIP = Path(__file__).parent / "chip"
MISSING = [name for name in ("arm-none-eabi-gcc", "qemu-system-arm") if which(name) is None]
WARNINGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic")
_CPU = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")
_QEMU = ("qemu-system-arm", "-M", "netduinoplus2", "-display", "none", "-monitor", "none", "-serial", "none")
_QEMU_TIME = ("-semihosting-config", "enable=on,target=native", "-icount", "shift=0")  # an instruction takes 1 ns
_CLOCK, _PERIOD = 168e6, 0.01  # Hz, of chip and timer; s


class OnChip(NamedTuple):
    """A policy on the chip."""

    output: str  # of the check of its golden vectors
    flash: int  # bytes of code and tables, without golden vectors and libm
    ram: int  # bytes of the stack, on which the memory of the flight is, with those of the check
    instructions: int  # of the longest step with supervisor
    errors: Sequence[str] = ()  # of golden vectors: here in double and in single precision, and on the chip


def check(source: Path, *flags: str) -> str:
    """Build a C file with its golden vectors for this computer with all warnings as errors, and run it."""
    program, vectors = source.with_suffix(".out"), source.with_name(f"{source.stem}_check.c")
    subprocess.run(["cc", *WARNINGS, *flags, source, vectors, "-lm", "-o", program], check=True)
    return subprocess.run([program], capture_output=True, text=True, check=False).stdout.strip()


def run_on_chip(source: Path, *flags: str) -> OnChip:
    """Build a C file with its golden vectors for the chip, run it, and measure it."""
    library, program, step = source.with_suffix(".o"), source.with_suffix(".elf"), f"{source.stem}_supervise"
    compiler, vectors = "arm-none-eabi-gcc", source.with_name(f"{source.stem}_check.c")
    own = (*WARNINGS, "-Wdouble-promotion", "-fno-math-errno")
    subprocess.run([compiler, *_CPU, *own, *flags, "-c", source, "-o", library], check=True)
    link = ("-nostartfiles", "--specs=rdimon.specs", "-Wl,--gc-sections", f"-Wl,--wrap={step}", "-T")
    parts = (f"-DSTEP={step}", library, vectors, _CHIP / "start.c", "-lm", "-o", program)
    subprocess.run([compiler, *_CPU, "-O2", *flags, *link, _CHIP / "stm32f405.ld", *parts], check=True)
    sizes = subprocess.run(["arm-none-eabi-size", library], capture_output=True, text=True, check=True).stdout
    ran = subprocess.run(
        [*_QEMU, *_QEMU_TIME, "-kernel", program], capture_output=True, text=True, timeout=300, check=False
    )
    found = re.fullmatch(r"(.*)\nticks (\d+) stack (\d+)\s*", ran.stdout)
    if found is None:
        raise RuntimeError(f"the program on the chip ended with {ran.returncode}: {ran.stdout}{ran.stderr}")
    flash = sum(map(int, sizes.splitlines()[1].split()[:2]))
    return OnChip(found[1], flash, int(found[3]), round(int(found[2]) / _CLOCK * 1e9))


def measure(name: str, scenario: str, folder: Path) -> OnChip:
    """Return a policy on the chip after its golden vectors have passed; its files are written into a folder.

    Raises:
        RuntimeError: They do not pass, here or there.
    """
    source = folder / f"{re.sub('[^a-z0-9]', '_', name)}_{scenario}.c"
    export_c(load_policy(name), name, find_scenarios([scenario])[scenario], source)
    errors = [check(source, *flags) for flags in (("-DQUADPEND_DOUBLE",), ())]
    chip = run_on_chip(source)
    if not all(text.startswith("passed") for text in (*errors, chip.output)):
        raise RuntimeError(f"{name}: golden vectors: {errors}, on the chip {chip.output}")
    return chip._replace(errors=[_error(text) for text in (*errors, chip.output)])


def row(name: str, scenario: str, folder: Path) -> list[str]:
    """Return the row of a policy."""
    chip = measure(name, scenario, folder)
    share = chip.instructions / (_CLOCK * _PERIOD)
    cells = [f"`{name}`", f"`{scenario}`", chip.errors[-1], f"{chip.flash / 1e3:.0f}", f"{chip.ram / 1e3:.1f}"]
    return [*cells, f"{chip.instructions:,}", f"{share:.1%}"]


def flown(name: str, episodes: int, folder: Path) -> list[str]:
    """Return the row of a policy designed for `flight_breeze`: where C and Python differ most in the set ``flight``."""
    known = find_scenarios(["flight_breeze"])["flight_breeze"]
    source = folder / f"{re.sub('[^a-z0-9]', '_', name)}.c"
    export_c(load_policy(name), name, known, source)
    survivals, errors = [], []
    for scenario in find_scenarios(["flight"]).values():
        both = (
            run_episodes([load_policy(p)], scenario, episodes, TEST_SEED, known=known) for p in (name, f"c:{source}")
        )
        python, compiled = both
        common = python.survived & compiled.survived
        survivals.append(int((python.survived != compiled.survived).sum()))
        means = [float(found.rmse[common].mean()) if common.any() else 1.0 for found in (python, compiled)]
        errors.append(abs(means[1] / means[0] - 1.0))
    return [f"`{name}`", str(sum(survivals)), f"{np.median(errors):.2%}", f"{max(errors):.2%}"]


def _error(text: str) -> str:
    return str(re.findall(r"error (\S+)", text)[0])


def main() -> None:
    """Measure all policies, and write a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, help="fly so many episodes in each scenario of the set flight")
    if given := parser.parse_args().episodes:
        with tempfile.TemporaryDirectory() as folder:
            flights = [flown(name, given, Path(folder)) for name in POLICIES["flight_breeze"]]
        headings = ["policy", "other survival", "error, median", "error, largest"]
        table = f"{made_by(f'deploy --episodes {given}', given, TEST_SEED)}\n\n{markdown_table(headings, flights)}"
        fill(DOCS / "deploy.md", {"flown": table})
        return
    if MISSING:
        print(f"Skipped, since {' and '.join(MISSING)} are not installed.")
        return
    headings = ["policy", "scenario", "error", "flash, kB", "RAM, kB", "instructions", "of 10 ms"]
    with tempfile.TemporaryDirectory() as folder:
        rows = [row(name, scenario, Path(folder)) for scenario, names in POLICIES.items() for name in names]
    fill(DOCS / "deploy.md", {"chip": markdown_table(headings, rows)})


if __name__ == "__main__":
    main()
