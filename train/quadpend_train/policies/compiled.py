"""Policies from C files that ``quadpend export --to c`` has written, compiled and flown in the environment."""

import ctypes
import re
from copy import copy
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadpend_baselines import Policy
from quadpend_baselines.estimation.feeding import fed_by_name
from quadpend_baselines.policy.protocol import episode_start_mask
from quadpend_gym.core.arrays import Booleans, Floats, Floats32
from quadpend_gym.core.c_library import load_c
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import LAB

SAMPLE_SIZE = LAB.size  # the fields of `LAB`, in their units
_ROWS = """
int memory_size(void) {{ return (int)sizeof({name}_{kind}); }}
void rows(int count, char *memory, const char *started, const {name}_real *samples, {name}_real *commands) {{
  for (int row = 0; row < count; ++row) {{
    {name}_{kind} *flight = ({name}_{kind} *)(void *)(memory + row * memory_size());
    const {name}_real *sample = samples + {size} * row;
    if (started[row]) {begin};
    {name}_{step}(flight, (const {name}_measurement *)(const void *)sample,
      (const {name}_reference *)(const void *)(sample + 11), ({name}_command *)(void *)(commands + 4 * row));
  }}
}}
"""
_STATUSES = """
void statuses(int count, const char *memory, uint32_t *status) {{
  for (int row = 0; row < count; ++row) {{
    status[row] = ((const {name}_supervisor *)(const void *)(memory + row * memory_size()))->status;
  }}
}}
"""


def is_c(name: str) -> bool:
    """Return whether a name is that of a C file, such as ``"c:policy.c"`` or ``"supervised:policy.c"``."""
    prefix = name.partition(":")[0]
    return prefix == "supervised" or (prefix in C_POLICIES and name.endswith(".c"))


def load_c_policy(name: str) -> "CPolicy":
    """Return the policy of a name for which `is_c`."""
    prefix, _, path = name.partition(":")
    if not path.endswith(".c"):
        raise ValueError(f"{prefix}: takes a C file of `quadpend export`, such as {prefix}:policy.c, not {path!r}")
    return C_POLICIES[prefix](path)


def samples_of(observation: Floats32) -> Floats:
    """Return what a C file takes for observations `LAB`, shape (n, 37)."""
    return np.asarray(observation * LAB.scale, np.float64)


class CPolicy(Policy):
    """A C file as a policy of the environment, in single precision.

    Args:
        path: The source, beside its header.
        flags: Macros such as ``QUADPEND_DOUBLE``, which are defined before.
    """

    layouts = (LAB,)
    has_linear_model = False
    kind, step, begin = "policy", "step", "{name}_reset(flight)"
    more = ""  # C behind the rows

    def __init__(self, path: str | Path, flags: tuple[str, ...] = ()) -> None:
        self.path, self.name, self.scale = Path(path), Path(path).stem, np.ones(4)
        header = self.path.with_suffix(".h")
        if not self.path.is_file() or not header.is_file():
            written = f"`quadpend export POLICY --to c --out {self.path.with_suffix('.c')}` writes both"
            raise ValueError(f"there must be a C file {self.path} with a header {header}: {written}")
        text, include = header.read_text(encoding="utf-8"), f'#include "{header.name}"'
        found = re.findall(rf'#define {self.name}_(PERIOD|LATENCY|INTERFACE|VEHICLE) ("[^"]*"|[\w.]+)', text)
        self.designed = {name: value.strip('"') for name, value in found}
        if len(self.designed) != 4:
            raise ValueError(f"{header} was not written by quadpend export")
        source = self.path.read_text(encoding="utf-8").replace(include, text)
        defined = "".join(f"#define {flag}\n" for flag in flags)
        values = {"name": self.name, "size": SAMPLE_SIZE, "kind": self.kind, "step": self.step}
        rows = _ROWS.format(**values, begin=self.begin.format(**values)) + self.more.format(**values)
        self.source = defined + source + rows
        self._real = np.float64 if "QUADPEND_DOUBLE" in flags else np.float32

    @cached_property
    def _library(self) -> Any:
        return load_c(self.source)

    def adapt(self, scenario: Scenario) -> Policy:
        """Return the policy for a scenario with the period and the interface for which the file was written."""
        simulation = scenario.simulation
        for name, value in (("PERIOD", repr(simulation.period)), ("INTERFACE", simulation.interface)):
            if self.designed[name] != value:
                raise ValueError(
                    f"{self.path} was written for the {name.lower()} {self.designed[name]}, not {value}: export it for"
                    " this scenario"
                )
        other = copy(self)
        other.scale = simulation.command_scale
        return fed_by_name(other, scenario)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return the action, and the memory; see `quadpend_baselines.Policy.predict`."""
        given = np.atleast_2d(np.asarray(observation, np.float32))
        command, memory = self.command(samples_of(given), state, episode_start)
        action = (command - self.scale * [1.0, 0.0, 0.0, 0.0]) / self.scale
        clipped = np.clip(action, -1.0, 1.0).astype(np.float32)  # what rounding adds
        return clipped.reshape(*np.shape(observation)[:-1], 4), memory

    def command(self, samples: Floats, state: Any = None, episode_start: Any = None) -> tuple[Floats, Any]:
        """Return thrust (N) and rates (rad/s) or torques (N·m) for samples of shape (n, 37), and the memories."""
        rows, library = len(samples), self._library
        started: Booleans = episode_start_mask(episode_start, state is None, rows)
        memory = np.zeros((rows, library.memory_size()), np.uint8) if state is None else state.copy()
        given, commands = np.ascontiguousarray(samples, self._real), np.empty((rows, 4), self._real)
        arrays = memory, started, given, commands
        library.rows(rows, *(array.ctypes.data_as(ctypes.c_void_p) for array in arrays))
        return commands.astype(float), memory


class SupervisedPolicy(CPolicy):
    """A C file with its supervisor, which is requested to fly from the first step on."""

    kind, step, more = "supervisor", "supervise", _STATUSES
    begin = "{name}_supervisor_reset(flight), flight->request = {name}_FLY"

    @cached_property
    def statuses(self) -> dict[str, int]:
        """The bits of a status by name."""
        found = re.findall(rf"{self.name}_(\w+) = 1 << (\d+)", self.path.with_suffix(".h").read_text(encoding="utf-8"))
        return {name: 1 << int(bit) for name, bit in found}

    def status(self, state: Any) -> NDArray[np.uint32]:
        """Return the statuses of the latest step, shape (n,), from the memory."""
        found, memory = np.empty(len(state), np.uint32), np.ascontiguousarray(state)
        self._library.statuses(len(found), *(array.ctypes.data_as(ctypes.c_void_p) for array in (memory, found)))
        return found


C_POLICIES = {"c": CPolicy, "supervised": SupervisedPolicy}  # by the prefix of their names
