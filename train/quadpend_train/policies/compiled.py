"""Policies from C files that ``quadpend export --to c`` has written, compiled and flown in the environment."""

import ctypes
import re
from copy import copy
from functools import cached_property
from math import factorial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from quadpend_baselines import Policy
from quadpend_baselines.estimation.feeding import fed_by_name
from quadpend_baselines.estimation.measurement import measurement_from_observation
from quadpend_baselines.policy.protocol import episode_start_mask
from quadpend_gym import Parameters, Simulation
from quadpend_gym.core.arrays import Booleans, Floats, Floats32
from quadpend_gym.core.c_library import load_c
from quadpend_gym.physics.state import State
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import LAB, OUTPUT_FEEDBACK

C_PREFIX = "c:"  # of the names of these policies
SAMPLE_SIZE = LAB.size  # the fields of `LAB`, in their units
_ROWS = """
int memory_size(void) {{ return (int)sizeof({name}_policy); }}
void rows(int count, char *memory, const char *started, const {name}_real *samples, {name}_real *commands) {{
  for (int row = 0; row < count; ++row) {{
    {name}_policy *policy = ({name}_policy *)(void *)(memory + row * memory_size());
    const {name}_real *sample = samples + {size} * row;
    if (started[row]) {name}_reset(policy);
    {name}_step(policy, (const {name}_measurement *)(const void *)sample,
                (const {name}_reference *)(const void *)(sample + 11), ({name}_command *)(void *)(commands + 4 * row));
  }}
}}
"""


def is_c(name: str) -> bool:
    """Return whether a name is that of a C file, such as ``"c:policy.c"``."""
    return name.startswith(C_PREFIX) and name.endswith(".c")


def samples_of(observation: Floats32) -> Floats:
    """Return what a C file takes for observations `LAB`, shape (n, 37)."""
    return np.asarray(observation * LAB.scale, np.float64)


class _Memory(NamedTuple):
    policy: Any  # copies of the C policy's memories
    place: Floats  # of the reference, and its velocity, in a frame that moves with its first velocity, shape (n, 2, 3)


def samples_of_errors(observation: Floats32, parameters: Parameters, place: Floats) -> Floats:
    """Return the same for observations without velocities, shape (n, 27), of a nominal pole.

    The place of the reference and its velocity, shape (n, 2, 3), are those in the frame of the sample.
    """
    measured = measurement_from_observation(observation, parameters.rod_length, OUTPUT_FEEDBACK)
    state, rows = State(measured.state), len(observation)
    x, y, z, w = Rotation.from_euler("xyz", state.euler).as_quat().T
    quaternion = np.stack([w, x, y, z], axis=1)
    orders = measured.reference.reshape(rows, -1), measured.yaw
    pole = np.tile([parameters.rod_length, parameters.bob_mass], (rows, 1))
    position = state.position + place[:, 0]
    return np.hstack(
        [position, quaternion, state.direction, np.zeros((rows, 1)), place.reshape(rows, -1), *orders, pole]
    )


def place_after(place: Floats, samples: Floats, period: float) -> Floats:
    """Return the place and the velocity of a reference a period (s) after samples."""
    later, orders = place.copy(), samples[:, 11:32].reshape(-1, 7, 3)
    for order in range(1, 7):
        for k in range(min(order, 2)):
            later[:, k] += period ** (order - k) / factorial(order - k) * orders[:, order]
    return later


class CPolicy(Policy):
    """A C file as a policy of the environment, in single precision.

    Args:
        path: The source, beside its header.
        flags: Macros such as ``QUADPEND_DOUBLE``, which are defined before.
    """

    layouts = (LAB, OUTPUT_FEEDBACK)
    has_linear_model = False

    def __init__(self, path: str | Path, flags: tuple[str, ...] = ()) -> None:
        self.path, self.name, self.scale, self.simulation = Path(path), Path(path).stem, np.ones(4), Simulation()
        self.in_world = True  # whether it is given the fields of `LAB`
        header = self.path.with_suffix(".h")
        if not self.path.is_file() or not header.is_file():
            raise ValueError(f"there must be a C file {self.path} with a header {header}, written by quadpend export")
        text, include = header.read_text(encoding="utf-8"), f'#include "{header.name}"'
        found = re.findall(rf"#define {self.name}_(PERIOD|LATENCY|INTERFACE|VEHICLE) \"?([\w.]+)", text)
        self.designed = dict(found)
        if len(self.designed) != 4:
            raise ValueError(f"{header} was not written by quadpend export")
        source = self.path.read_text(encoding="utf-8").replace(include, text)
        defined = "".join(f"#define {flag}\n" for flag in flags)
        self.source = defined + source + _ROWS.format(name=self.name, size=SAMPLE_SIZE)
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
        other.scale, other.simulation = simulation.command_scale, simulation
        other.in_world = set(LAB) <= set(scenario.observation)
        return fed_by_name(other, scenario)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return the action, and the memory; see `quadpend_baselines.Policy.predict`."""
        given = np.atleast_2d(np.asarray(observation, np.float32))
        started = episode_start_mask(episode_start, state is None, len(given))
        place = np.zeros((len(given), 2, 3)) if state is None else state.place * ~started[:, np.newaxis, np.newaxis]
        p = self.simulation.parameters
        samples = samples_of(given) if self.in_world else samples_of_errors(given, p, place)
        command, memory = self.command(samples, None if state is None else state.policy, started)
        memory = _Memory(memory, place_after(place, samples, self.simulation.period))
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
