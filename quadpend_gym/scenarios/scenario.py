"""`Scenario`: an environment with its task, vehicle, wind, sensors, actuators and parameters, as data."""

import math
import re
from dataclasses import field, replace
from functools import cached_property
from typing import Annotated, Any

import gymnasium as gym
from gymnasium.vector import AutoresetMode, VectorEnv
from pydantic import Strict

from quadpend_gym.actuators import ActuatorsField, check_chain
from quadpend_gym.autopilots import AutopilotField, Betaflight
from quadpend_gym.core.models import to_plain_data
from quadpend_gym.core.settings import Range, settings
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.randomization import Around, LoopRanges, ParameterRanges, RangesField
from quadpend_gym.sensors import SensorsField, check_periods
from quadpend_gym.tasks.feasibility import check_feasible
from quadpend_gym.tasks.observation import FULL, ObservationLayout, ObservationSetting
from quadpend_gym.tasks.task import TASKS, Task, TaskField
from quadpend_gym.vehicles import CONTROL_PERIOD, VEHICLES, Simulation, Vehicle
from quadpend_gym.vehicles.simulation import Interface
from quadpend_gym.vehicles.vehicle import VehicleField
from quadpend_gym.wind import PRESETS, as_wind
from quadpend_gym.wind.base import WINDS, can_hold
from quadpend_gym.wind.steady import Factors, Relative, Rising, for_vehicle, rescaled

__all__ = ["Scenario", "scenario_data"]


_SUBSTEP = CONTROL_PERIOD / 2  # s, the longest one if `substeps` is None


@settings
class Scenario:
    """An environment: what is to be done, by which vehicle, and what disturbs it.

    The names of its parts are the keywords of `gymnasium.make`, and the fields of a scenario file.
    """

    task: Annotated[Task, TaskField] = field(default_factory=lambda: TASKS["track"])  # a mapping changes "track"
    # a model, the name of a preset, a mapping with a ``kind``, "module:factory", or a sum or list of these; presets are
    # `Relative`: their forces and torques are scaled from the paper's vehicle to this one
    wind: Annotated[Any, WINDS.field()] = ()
    vehicle: Annotated[Vehicle, VehicleField] = field(default_factory=lambda: VEHICLES["paper"])
    interface: Interface = "wrench"  # what an action commands
    latency: Annotated[float, Range(0.0, 1.0, "s")] = 0.0  # from an action to the moment when it acts; whole substeps
    sensors: Annotated[Any, SensorsField] = ()  # in the order in which they are applied
    actuators: Annotated[Any, ActuatorsField] = ()  # in the order in which an action passes them
    parameters: Annotated[ParameterRanges | Around, RangesField] | None = None  # drawn for each episode; None: nominal
    loop: LoopRanges | None = None  # latency, rate loop, rotor lags and thrust, drawn for each episode; None: nominal
    # ``"betaflight[:TUNE]"``: real firmware in place of the rate loop
    autopilot: Annotated[Betaflight | None, AutopilotField] = None
    period: Annotated[float, Range(1e-9, 10.0, "s")] = CONTROL_PERIOD
    # Runge–Kutta steps in a control period; None: as many as are at most 5 ms long
    substeps: Annotated[int | None, Range(1, 10_000)] = None
    duration: Annotated[float, Range(1e-9, 1e7, "s")] = 10.0  # length of an episode
    wind_rise: Annotated[float, Range(0.0, 1e6, "s")] = 0.0  # the wind is multiplied by min(t/wind_rise, 1); 0: by 1
    unscored: Annotated[float, Range(0.0, 1e7, "s")] = 0.0  # at the beginning, where no error counts but falls do
    # ``"full"``, ``"output_feedback"`` without velocities, ``"lab"``, or a list of the fields of `tasks.observation`
    observation: Annotated[ObservationLayout, ObservationSetting] = FULL
    pole_told: Annotated[bool, Strict()] = False  # whether the observed ``"pole"`` is the true one, not the nominal one
    loop_known: Annotated[bool, Strict()] = True  # whether controllers know the delays, lags and rate limits above
    name: str = field(default="", compare=False)
    description: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        if self.task.trajectory is not None:
            check_feasible(self.task.trajectory, self.simulation, self.task.side)
        check_chain(self.actuators, self.simulation)
        if can_hold(self.wind_models):
            _ = plant_of(self.simulation).held_kernel  # refuses a vehicle whose pole cannot be held
        check_periods(self.sensors, self.period)
        if self.unscored_steps >= self.steps:
            raise ValueError(f"unscored must be less than the duration of {self.duration:g} s, not {self.unscored:g} s")
        if self.loop is not None:
            self.loop.check(self.simulation)
        if self.autopilot is not None:
            self.autopilot.check(self.simulation, self.loop and self.loop.rate_loop)

    @cached_property
    def simulation(self) -> Simulation:
        """The vehicle with its interface, control period, substeps and latency."""
        substeps = self.substeps or substeps_in(self.period, _SUBSTEP)
        return Simulation(self.vehicle, self.interface, self.period, substeps, self.latency)

    @cached_property
    def wind_models(self) -> tuple[Any, ...]:
        """The models of the wind; those of presets are scaled for the vehicle, and they rise with `wind_rise`."""
        models = wind_models(self.wind, self.simulation)
        return tuple(Rising(model, self.wind_rise) for model in models) if self.wind_rise else models

    @property
    def steps(self) -> int:
        """Number of control steps of an episode: it ends with the first one at or after `duration`."""
        return math.ceil(self.duration / self.period * (1.0 - 1e-9))

    @property
    def unscored_steps(self) -> int:
        """Number of control steps that end within `unscored`."""
        return math.floor(self.unscored / self.period * (1.0 + 1e-9))

    def with_vehicle(self, vehicle: Any = None, interface: str | None = None) -> "Scenario":
        """Return the scenario with another vehicle, another command interface, or both.

        Forces of the wind are multiplied by the ratio of the weights of the new and the old vehicle, and torques by
        that of their torque limits about each axis, so that they are as strong for the one as for the other. What a
        lab brings does not change: wind velocities, starts, references, sensors, actuators, and stiffness and damping
        of a hand. The name gets vehicle and interface, such as ``"windy · crazyflie · body_rates"``.

        None keeps that of the scenario.
        """
        given = {key: value for key, value in {"vehicle": vehicle, "interface": interface}.items() if value is not None}
        simulation = replace(self.simulation, **given)
        own, factors = _factors(Simulation(), self.simulation), _factors(self.simulation, simulation)
        wind = [
            model
            for item in self.wind
            for model in ((item,) if isinstance(item, Relative) else rescaled(for_vehicle((item,), own), factors))
        ]
        added = ([simulation.vehicle.name] if vehicle is not None else []) + ([interface] if interface else [])
        return replace(self, **given, wind=wind, name=" · ".join([self.name, *added]) if self.name else "")

    def make(self, **arguments: Any) -> gym.Env[Any, Any]:
        """Return an environment of the scenario; `arguments` are further ones of `gymnasium.make`."""
        env: gym.Env[Any, Any] = gym.make("quadpend_gym:QuadPendulum-v0", scenario=self, **arguments)
        return env

    def make_vec(
        self, num_envs: int, autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP, **arguments: Any
    ) -> VectorEnv[Any, Any, Any]:
        """Return a vector environment of the scenario; `arguments` are further ones of `gymnasium.make_vec`."""
        env: VectorEnv[Any, Any, Any] = gym.make_vec(
            "quadpend_gym:QuadPendulum-v0", num_envs, scenario=self, autoreset_mode=autoreset_mode, **arguments
        )
        return env


def substeps_in(period: float, longest: float) -> int:
    """Return the number of substeps in a period, none of which is longer than the longest one, s."""
    return math.ceil(period / longest * (1.0 - 1e-9))


def wind_models(wind: Any, simulation: Simulation) -> tuple[Any, ...]:
    """Return the models of a wind, as `Scenario.wind`; relative ones are scaled for the vehicle of a simulation."""
    return for_vehicle(as_wind(wind), _factors(Simulation(), simulation))


def _factors(old: Simulation, new: Simulation) -> Factors:
    """Return the ratios of the weights and of the torque limits about each axis."""
    roll_pitch, yaw = (after / before for after, before in zip(new.torque_limits, old.torque_limits, strict=True))
    return new.parameters.hover_thrust / old.parameters.hover_thrust, (roll_pitch, roll_pitch, yaw)


def scenario_data(scenario: Scenario) -> dict[str, Any]:
    """Return the fields of a scenario as data for JSON, from which `Scenario` makes it again.

    Presets of the wind become their names, and an object of the user's own class its `repr` without its address in
    memory.
    """
    data: dict[str, Any] = to_plain_data(scenario, lambda item: re.sub(r" at 0x[0-9a-fA-F]+", "", repr(item)))
    pairs = zip(scenario.wind, data["wind"], strict=True)
    data["wind"] = [next((name for name, model in PRESETS.items() if model == item), own) for item, own in pairs]
    return data
