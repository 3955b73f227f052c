"""The control step of an environment as C for one row: "numbers in, values out", for the CPU and, as CUDA, for a GPU.

CasADi reads the functions and models that `World` computes with, as functions of the memory of a row and of numbers
uniform in (0, 1). `control_step.c` has what CasADi cannot do: the integers of the random streams, the queue of actions
under way, the loop over substeps, and the next episode of a row whose episode ends. The memory of a row is an array of

| part | content |
|---|---|
| x | state, and for rigid vehicles quaternion, body rate and rotor thrusts |
| act, wind, sense | memories of the actuators, the wind models and the sensors |
| queue, arrival | actions under way, the oldest first; with a drawn loop also when each acts, in substeps from now |
| jump | memory of the jumps of the reference, and how far it has jumped |
| parameters, reference, loop | of the episode; the loop with its latency in substeps, if it is drawn |
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from quadpend_gym.core import events, streams
from quadpend_gym.core.delays import delay, hold
from quadpend_gym.engines.functions import actions_under_way, plant_lanes
from quadpend_gym.engines.lifting import columns, lift, lift_model, rows, vector
from quadpend_gym.engines.scalar_c import scalar_c
from quadpend_gym.envs import step_kernel
from quadpend_gym.envs.kernel_layout import make_limits, make_weights
from quadpend_gym.envs.loops import CHANGE_STREAM, JITTER_STREAM, Schedule, lateness
from quadpend_gym.physics.drag import add_drag
from quadpend_gym.physics.dynamics import load_physics
from quadpend_gym.physics.plant_kernel import LANE_STATE_SIZE, LOOP_EFFICIENCY, LOOP_SIZE
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import store_outputs
from quadpend_gym.physics.rigid_settings import loop_numbers, nominal_loop
from quadpend_gym.physics.state import (
    ACTION_SIZE,
    COMMAND_SIZE,
    DIRECTION,
    DIRECTION_RATE,
    DISTURBANCE_SIZE,
    EULER,
    STATE_SIZE,
)
from quadpend_gym.physics.vectors import load
from quadpend_gym.scenarios.scenario import Scenario
from quadpend_gym.sensors import AGE
from quadpend_gym.tasks import rewards
from quadpend_gym.tasks.observation import (
    ALL,
    Target,
    observe_measured,
    observe_reference,
    observe_state,
    observe_target,
    tracking_errors,
)
from quadpend_gym.tasks.references import CHANNELS, REFERENCE_SIZE, draw_reference
from quadpend_gym.tasks.starts import StartPole, draw_start, start_pole
from quadpend_gym.tasks.trajectories import Reference, reference_at
from quadpend_gym.vehicles.parameters import BOB_MASS, PARAMETERS_SIZE, ROD_LENGTH
from quadpend_gym.wind import WIND_FIELDS, WIND_SIZE
from quadpend_gym.wind.base import SAMPLE_SIZE, can_hold

_SOURCE = Path(__file__).with_suffix(".c")
_NOUNS = {"act": "actuator", "wind": "wind", "sense": "sensor"}


class _Draws:
    """The uniform numbers that a function takes; a stream is the tuple of its numbers below that of the episode.

    A place in a stream is an integer that follows from the time, or a function of it and of the memory of a row.
    """

    def __init__(self, clock: Any, memory: Any, period: float) -> None:
        self.clock, self._memory, self._period = clock, memory, period
        self._found: dict[tuple[tuple[int, ...], int, int], Any] = {}
        self._places: list[Any] = []  # those that are functions of the memory
        self.replaced: dict[Any, Any] = {
            streams.uniform: self._uniform,
            streams.derive: lambda key, number: (*key, int(number)),
            streams.Streams: lambda keys: lift_model(streams.Streams(keys), self.replaced),
            hold: _hold,
            delay: self._delay,
            events.first_events: self._first_events,
            events.next_events: self._next_events,
            events.present_events: self._present_events,
        }

    @property
    def symbols(self) -> Any:
        return ca.vertcat(*self._found.values())

    def stream(self, *key: int) -> Any:
        keys = np.empty(1, object)
        keys[0] = key
        return lift_model(streams.Streams(keys), self.replaced)

    def _uniform(self, key: tuple[int, ...], index: Any) -> Any:
        if ca.depends_on(ca.SX(index), self._memory):
            self._places.append(index)
            return self._found.setdefault((key, 0, -len(self._places)), ca.SX.sym("u"))
        first, second, third = (float(ca.substitute(ca.SX(index), self.clock, k)) for k in (0, 1, 2))
        if third - second != second - first:
            raise ValueError("it draws at times that depend on what it drew before")
        place = key, int(second - first), int(first)
        return self._found.setdefault(place, ca.SX.sym("u"))

    def _delay(self, values: Any, step: Any, memory: Any, steps: int, repeats_first: bool = False) -> None:
        now = values.copy()
        if repeats_first and step[0].is_constant():
            memory[:] = np.tile(now, steps)
        else:
            values[:], memory[:] = memory[:, : now.size], np.hstack([memory[:, now.size :], now])

    def _first_events(self, memory_size: int, streams: Any, draw: Any) -> Any:
        memory = rows([0.0] * (memory_size - 1) + [-1.0])
        draw(memory, np.full(1, True), streams)
        return memory

    def _next_events(self, memory: Any, chosen: Any, streams: Any, pause: Any, length: Any, *bounds: Any) -> list[Any]:
        if pause[0] + length[0] < self._period:
            raise ValueError("its events can follow each other within a control period")
        memory[:, -1] += 1.0
        waited, lasts, *drawn = list(streams.between(memory[:, -1], *zip(pause, length, *bounds, strict=True)).T)
        memory[:, 0] += memory[:, 1] + waited
        memory[:, 1] = lasts
        return drawn

    def _present_events(self, memory: Any, time: Any, streams: Any, draw: Any) -> Any:
        ended, after = time > memory[:, 0] + memory[:, 1], memory.copy()
        draw(after, np.full(1, True), streams)
        for column in range(memory.shape[1]):
            memory[0, column] = ca.if_else(ended[0], after[0, column], memory[0, column])
        return time > memory[:, 0]

    def as_c(self, name: str) -> str:
        """Return a C function that computes the numbers."""
        keys = sorted({key[:size] for key, _, _ in self._found for size in range(1, len(key) + 1)}, key=len)
        names = {key: f"k{i}" for i, key in enumerate(keys)} | {(): "key"}
        lines = [f"FN void {name}_draws(u64 key, u64 step, const real *m, real *u) {{"]
        text = ""
        if self._places:
            given, place = {"m_": self._memory, "clock_": self.clock}, ca.vertcat(*self._places)
            text = scalar_c(ca.Function(f"{name}_places", [*given.values()], [place], [*given], ["place"]))
            text = text.replace("static void", "FN void")
            lines.append(f"real time = (real)step, place[{len(self._places)}]; {name}_places(m, &time, place);")
        lines += [f"u64 {names[key]} = derive({names[key[:-1]]}, {key[-1]});" for key in keys]
        for i, (key, slope, offset) in enumerate(self._found):
            number = f"{slope} * step + {offset}" if offset >= 0 else f"(u64)place[{-offset - 1}]"
            lines.append(f"u[{i}] = uniform({names[key]}, {number});")
        return text + "\n  ".join([*lines, "(void)key; (void)step; (void)m; (void)u;"]) + "\n}\n"


def _hold(values: Any, memory: Any, held: Any) -> None:
    for column in range(values.shape[1]):
        values[0, column] = ca.if_else(held[0], memory[0, column], values[0, column])
    memory[:] = values


@dataclass(frozen=True)
class ControlStep:
    """The C source of a scenario, and the sizes of its arrays."""

    source: str
    sizes: dict[str, int]


def control_step(scenario: Scenario) -> ControlStep:
    """Return the control step of a scenario as C.

    Raises:
        ValueError: The scenario has a part that this engine does not cover.
    """
    return _Generator(scenario).generate()


def rows_of(*functions: Any) -> str:
    """Return C source for `Library` that calls functions of CasADi, which must not share names, for n rows.

    It has ``NAME_rows`` for each function, with its arguments and then its results of shape (size, n).
    """
    text = _SOURCE.read_text(encoding="utf-8").partition("// GENERATED")[0]
    for function in functions:
        arguments = {function.name_in(i): function.numel_in(i) for i in range(function.n_in())}
        results = {function.name_out(i): function.numel_out(i) for i in range(function.n_out())}
        given = [f"const real *{name}_0" for name in arguments] + [f"real *{name}_1" for name in results]
        buffers = ", ".join(f"{name}[SOME({size})]" for name, size in {**arguments, **results}.items())
        text += scalar_c(function).replace("static void", "FN void")
        text += f"ROWS({function.name()}_rows, {', '.join(given)}) {{\n  EACH_ROW {{\n    real {buffers};\n"
        text += "".join(f"    LOAD({name}, {name}_0, {size});\n" for name, size in arguments.items())
        text += f"    {function.name()}({', '.join([*arguments, *results])});\n"
        text += "".join(f"    STORE({name}_1, {name}, {size});\n" for name, size in results.items()) + "  }\n}\n"
    return text


class _Generator:
    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self.simulation, self.task = scenario, scenario.simulation, scenario.task
        if scenario.autopilot is not None:
            raise ValueError(
                "device: the generated kernel runs no autopilot: leave it out, for the rate loop of the vehicle"
            )
        if scenario.loop is not None and scenario.loop.rotor_lag is not None:
            raise ValueError("device: the generated kernel does not draw loop.rotor_lag: leave it out")
        if self.task.trajectory is not None and not isinstance(self.task.trajectory, Reference):
            raise ValueError("device: the generated kernel has no waypoints: take a Reference")
        self.plant, self.holds = plant_of(self.simulation), can_hold(scenario.wind_models)
        self.kernel = self.plant.held_kernel if self.holds else self.plant.kernel
        self.loop = None if scenario.loop is None else Schedule(scenario.loop, self.simulation, 1)
        self.moves_air = any(model.moves_air for model in scenario.wind_models)
        count = actions_under_way(self.simulation, scenario.loop)
        count = max(count, 1) if self.task.reward.action_rate else count  # that compares the last action
        models = scenario.actuators, scenario.wind_models, scenario.sensors
        sizes = {
            "x": STATE_SIZE + self.plant.memory_size,
            **{
                name: sum(m.memory_size for m in part)
                for name, part in zip(("act", "wind", "sense"), models, strict=True)
            },
            "queue": ACTION_SIZE * count,
            "arrival": count if self.loop else 0,
            "jump": self.task.jumps.memory_size + CHANNELS if self.task.jumps else 0,
            "parameters": PARAMETERS_SIZE,
            "reference": REFERENCE_SIZE,
            "loop": LOOP_SIZE + 1 if self.loop else 0,
        }
        ends = [0, *accumulate(sizes.values())]
        air = 3 + (SAMPLE_SIZE - WIND_SIZE if self.holds else 0)
        self.sizes = sizes | {
            "slots": count + 1,
            "memory": ends[-1],
            "observation": scenario.observation.size,
            "air": air,
            "blown": SAMPLE_SIZE if self.holds else WIND_SIZE,
        }
        self.parts = {name: slice(*pair) for name, pair in zip(sizes, pairwise(ends), strict=True)}
        self._symbols: Any = ca.SX.sym("m", ends[-1])
        self._memory = self._symbols

    def generate(self) -> ControlStep:
        clock = ca.SX.sym("clock")
        text, memory = "", self._symbols
        draws = self._draws(clock)
        m, observation = self._start(draws)
        text += self._c("start", draws, {}, next_m=m, observation=observation)
        # What is the same number in every episode is a number in the equations.
        entries = ca.vertsplit(self._memory)
        end = self.parts["loop"].start if self.scenario.loop and self.scenario.loop.changes else len(entries)
        for i in range(self.parts["parameters"].start, end):
            if m[i].is_constant():
                entries[i] = m[i]
        self._memory = ca.vertcat(*entries)
        action, acting, issued = (ca.SX.sym(name, ACTION_SIZE) for name in ("action", "acting", "issued"))
        x, air = (ca.SX.sym(name, self.sizes[name]) for name in ("x", "air"))
        force = ca.SX.sym("force", DISTURBANCE_SIZE)
        given = {"m": memory, "clock": clock}
        draws = self._draws(clock)
        text += self._c("actuate", draws, {"action": action, **given}, **self._act(draws, action))
        draws = self._draws(clock)
        text += self._c("blow", draws, given, **self._blow(draws))
        arguments = {"x": x, "acting": acting, "force": force, "air": air}
        m = self._memory
        following = self.substep(x, acting, force, air, m[self.parts["parameters"]], m[self.parts["loop"]])
        text += self._c("substep", None, {"m": memory, **arguments}, next_x=following)
        draws = self._draws(clock)
        text += self._c("finish", draws, {"x": x, "issued": issued, **given}, **self._finish(draws, x, issued))
        text += f"#ifdef MOTION\n{self._derivatives(arguments)}#endif\n"
        sizes = self.sizes | {
            "substeps": self.simulation.substeps,
            "delay": self.simulation.delayed_substeps,
            "drawn": int(self.loop is not None),
            **{f"{name}_at": part.start for name, part in self.parts.items()},
        }
        defines = "".join(f"#define N_{name.upper()} {size}\n" for name, size in sizes.items())
        source = _SOURCE.read_text(encoding="utf-8")
        return ControlStep(source.replace("// GENERATED\n", defines + text), sizes)

    def _c(self, name: str, draws: _Draws | None, arguments: dict[str, Any], **results: Any) -> str:
        """Return a function as C, with one that computes the uniform numbers that it takes."""
        if draws is not None:
            arguments = arguments | {"u": draws.symbols}
            size = max(draws.symbols.numel(), 1)
        dense = {f"{key}_{name}": ca.densify(ca.SX(value)) for key, value in results.items()}
        names = {f"{key}_": value for key, value in arguments.items()}
        function = ca.Function(name, [*names.values()], ca.cse([*dense.values()]), [*names], [*dense])
        text = scalar_c(function).replace("static void", "FN void")
        return text if draws is None else f"#define {name.upper()}_DRAWS {size}\n{text}{draws.as_c(name)}"

    def _draws(self, clock: Any) -> _Draws:
        return _Draws(clock, self._symbols, self.simulation.period)

    def _part(self, name: str) -> Any:
        return self._memory[self.parts[name]]

    def _apply(self, draws: _Draws, name: str, use: Callable[[Any, Any, Any], None], memories: Any = None) -> list[Any]:
        """Let the models of a part act, each with its memory and its stream; return the memories."""
        models = {"act": self.scenario.actuators, "wind": self.scenario.wind_models, "sense": self.scenario.sensors}
        numbers = {"act": streams.ACTUATOR_STREAM, "wind": streams.WIND_STREAM, "sense": streams.SENSOR_STREAM}
        count, entries, after, first = len(models[name]), ca.vertsplit(self._part(name)), [], 0
        for i, model in enumerate(models[name]):
            number = count - 1 - i if name == "act" else i
            try:
                lifted = lift_model(model, draws.replaced)
                stream = draws.stream(numbers[name], number)
                if memories is None:
                    memory = rows(entries[first : first + model.memory_size])
                else:
                    memory = rows(lifted.initial_memory(stream)[0])
                use(lifted, memory, stream)
            except Exception as error:
                kinds = " with ".join(re.findall(r"kind='(?!sum)([\w.:]+)'", repr(model))) or type(model).__name__
                raise ValueError(f"device: the generated kernel cannot step the {_NOUNS[name]} {kinds}") from error
            first += model.memory_size
            after += list(memory[0])
        return after

    def _start(self, draws: _Draws) -> tuple[Any, Any]:
        """Return the memory and the observation at the beginning of an episode."""
        simulation, task, ranges = self.simulation, self.task, self.scenario.parameters
        parameters = list(simulation.parameters.as_array())
        if ranges is not None:
            found = ranges.ranges(simulation.parameters)
            stream = draws.stream(streams.PARAMETER_STREAM)
            parameters = list(lift_model(found, draws.replaced).draw(simulation.parameters, stream)[0])
        physics = columns(parameters)
        reference = columns([], REFERENCE_SIZE)
        if task.trajectory is None:
            key = (streams.REFERENCE_STREAM,)
            lift(draw_reference, draws.replaced)(key, task.references, reference, 0)
        else:
            reference[:, 0] = task.trajectory.as_array()
        point = lift(reference_at)(reference, 0, 0.0)
        state = columns([], STATE_SIZE)
        pole = StartPole(*start_pole(simulation, task.side).tolist())
        arguments = task.start, pole, point, lift(load_physics)(physics, 0), state, 0
        lift(draw_start, draws.replaced)((streams.START_STREAM,), *arguments)
        x = list(state[:, 0])
        x += list(lift(type(self.plant).initial_memory)(self.plant, rows(x))[0])
        step, period = self._step(0), simulation.period
        act = self._apply(draws, "act", lambda *_: None, ())
        wind = self._apply(draws, "wind", lambda *_: None, ())
        measured = rows([*state[:, 0], 0.0])
        sense = self._apply(draws, "sense", lambda model, *own: model.sense(measured, own[0], step, period, own[1]), ())
        queue = [0.0] * self.sizes["queue"] + [0.0] * self.sizes["arrival"]
        loop = []
        if self.loop is not None:
            stream = draws.stream(streams.LOOP_STREAM)
            latency, *factors = lift_model(self.loop, draws.replaced).draw(stream)[0]
            loop = [*lift(loop_numbers)(simulation, *factors), latency]
        jump: list[Any] = []
        if task.jumps is not None:
            jumps = lift_model(task.jumps, draws.replaced)
            jump = [*jumps.initial_memory(draws.stream(streams.JUMP_STREAM, 0))[0], *[0.0] * CHANNELS]
        memory = [*x, *act, *wind, *sense, *queue, *jump, *parameters, *list(reference[:, 0]), *loop]
        return ca.vertcat(*memory), self._observe(measured, parameters, point)

    @staticmethod
    def _step(number: Any) -> Any:
        return rows([ca.SX(number)])[0]

    def _observe(self, measured: Any, parameters: Any, point: Any) -> Any:
        state, out = columns(list(measured[0])), columns([], ALL.size)
        target = Target(point.d0, point.d1, point.yaw)
        tracking = lift(tracking_errors)(state, 0, parameters[ROD_LENGTH], target)
        believed = parameters if self.scenario.pole_told else self.simulation.parameters.as_array()
        lift(observe_target)(target, believed[ROD_LENGTH], believed[BOB_MASS], 0, out)
        lift(observe_measured)(state, 0, state[AGE, 0], out, 0)
        lift(observe_state)(state, 0, tracking, out, 0)
        lift(observe_reference)(point, 0, out)
        return ca.vertcat(*out[ALL.select(self.scenario.observation), 0])

    def _act(self, draws: _Draws, action: Any) -> dict[str, Any]:
        """Return the action after the actuators, when it acts, and the memory of the actuators."""
        acted, step = rows(ca.vertsplit(action)), self._step(draws.clock)
        memory = self._apply(draws, "act", lambda model, *own: model.act(acted, own[0], step, self.simulation, own[1]))
        late, loop = 0.0, self._part("loop")
        if self.loop is not None:
            loop = self._changed(draws, loop)
            key = (streams.LOOP_STREAM, JITTER_STREAM)
            latency = loop[LOOP_SIZE]
            late = lift(lateness, draws.replaced)(key, draws.clock, latency, self.loop.jitter)
        return {"acted": vector(acted), "late": late, "act": ca.vertcat(*memory), "loop": loop}

    def _changed(self, draws: _Draws, loop: Any) -> Any:
        """Return the loop of the present control step, after the change within the episode if there is one."""
        if self.scenario.loop is None or self.scenario.loop.changes is None:
            return loop
        before, stream = ca.vertsplit(loop), draws.stream(streams.LOOP_STREAM, CHANGE_STREAM)
        given = rows([before[LOOP_SIZE]])[0], rows([before[LOOP_EFFICIENCY]])[0]
        step, latency, _, efficiency = lift_model(self.loop, draws.replaced).draw_change(*given, stream)
        after = [*before[:LOOP_EFFICIENCY], *efficiency[0], *before[LOOP_EFFICIENCY + ACTION_SIZE : LOOP_SIZE]]
        return ca.if_else(draws.clock >= step[0], ca.vertcat(*after, latency[0]), loop)

    def _blow(self, draws: _Draws) -> dict[str, Any]:
        """Return forces and torque with drag, the velocity of the air and a hand, the wind's memory, and its sample."""
        wind, step = rows([0.0] * self.sizes["blown"]), self._step(draws.clock)
        period = self.simulation.period
        memory = self._apply(draws, "wind", lambda model, *own: model.sample(wind, own[0], step, period, own[1]))
        whole = ca.SX(vector(wind))
        force, air = self.drag(self._part("x"), whole, self._part("parameters"))
        return {"force": force, "air": air, "wind": ca.vertcat(*memory), "blown": whole}

    def drag(self, x: Any, wind: Any, parameters: Any) -> tuple[Any, Any]:
        """Return forces and torque with drag, constant during a control period, and the air's velocity and a hand."""
        force, air = columns(wind[:DISTURBANCE_SIZE]), columns(wind[WIND_FIELDS["velocity"]])
        if self.plant.memory_size or self.moves_air:
            lift(add_drag)(lift(load)(air, 0, 0), columns(x), columns(parameters), 0, force)
        return vector(force), ca.vertcat(vector(air), wind[WIND_SIZE:])

    def substep(self, x: Any, acting: Any, force: Any, air: Any, parameters: Any, loop: Any = None) -> Any:
        """Return x after a substep under the action that acts in it."""
        h, physics, disturbance = self.simulation.period / self.simulation.substeps, columns(parameters), columns(force)
        numbers = nominal_loop(self.simulation) if self.loop is None else loop
        loops = columns(numbers[:LOOP_SIZE], LOOP_SIZE + 1)
        loops[LOOP_SIZE, 0] = 0.0  # the action acts that is issued
        lanes, plant = self._lanes(x), self.plant
        blowing = disturbance, columns(air[:3]), columns(air[3:])
        flying = lanes, columns(acting), loops, *blowing, physics, plant.settings()
        nothing = dict.fromkeys((add_drag, store_outputs), lambda *_: None)  # once in a control period
        lift(self.kernel.integrate, nothing)(*flying, 1, h, 1, columns([], COMMAND_SIZE))
        own = lanes[LANE_STATE_SIZE : LANE_STATE_SIZE + plant.memory_size]
        return ca.vertcat(vector(lanes[:STATE_SIZE]), vector(own))

    def _lanes(self, x: Any) -> Any:
        return plant_lanes(self.simulation, x[:STATE_SIZE], x[STATE_SIZE:])

    def outputs(self, x: Any) -> Any:
        """Return the Euler angles and their rates, which those of a rigid vehicle's body follow."""
        lanes = self._lanes(x)
        lift(self.plant.kernel.store_outputs)(lanes, 0)
        return vector(lanes[EULER:DIRECTION])

    def _finish(self, draws: _Draws, x: Any, issued: Any) -> dict[str, Any]:
        """Return what follows from the motion: the state, the observation, the reward and whether the episode ends."""
        simulation, task, before = self.simulation, self.task, self._part("x")
        after = ca.vertcat(x[:EULER], self.outputs(x), x[DIRECTION:])
        lost = lift(step_kernel.has_diverged)(columns(after[:STATE_SIZE]), 0)
        after = ca.if_else(lost, before, after)
        lanes, parameters = self._lanes(after), self._part("parameters")
        lift(self.plant.kernel.store_axis)(lanes, 0)
        time, reference = simulation.period * (draws.clock + 1), columns(self._part("reference"))
        jump = self._jump(draws)
        for channel, offset in enumerate(jump[-CHANNELS:]):
            reference[channel, 0] += offset
        point = lift(reference_at)(reference, 0, time)
        rod_length = parameters[ROD_LENGTH]
        tracking = lift(tracking_errors)(lanes, 0, rod_length, Target(point.d0, point.d1, point.yaw))
        cosine, weights = task.side * lanes[DIRECTION + 2, 0], make_weights(task)
        limits = make_limits(task, simulation)
        ended = ca.fmax(lost, lift(step_kernel.cause_of_fall)(lanes, 0, tracking.error, rod_length, limits))
        terms = lift(rewards.reward_terms)(tracking.error, cosine, tracking.yaw_error, columns(issued), 0, weights.tip)
        reward = lift(rewards.reward)(terms, cosine, lift(load)(lanes, DIRECTION_RATE, 0), weights)
        period = simulation.period
        if share := task.reward.action_rate:
            reward *= rewards.steady_share(issued - self._part("queue")[-ACTION_SIZE:], period, share)
        measured, step = rows([*lanes[:STATE_SIZE, 0], 0.0]), self._step(draws.clock + 1)
        sense = self._apply(draws, "sense", lambda model, *own: model.sense(measured, own[0], step, period, own[1]))
        return {
            "x": after,
            "sense": ca.vertcat(*sense),
            "jump": ca.vertcat(*jump),
            "observation": self._observe(measured, parameters, point),
            "reward": reward,
            "ended": ended,
            "error": vector(tracking.error),
        }

    def _jump(self, draws: _Draws) -> list[Any]:
        """Return the memory of the jumps for the next control step, and how far the reference has jumped then."""
        if self.task.jumps is None:
            return []
        entries, step = ca.vertsplit(self._part("jump")), self._step(draws.clock + 1)
        memory, offset = rows(entries[:-CHANNELS]), rows(entries[-CHANNELS:])
        stream = draws.stream(streams.JUMP_STREAM, 0)
        lift_model(self.task.jumps, draws.replaced).jump(offset, memory, step, self.simulation.period, stream)
        return [*memory[0], *offset[0]]

    def _derivatives(self, arguments: dict[str, Any]) -> str:
        """Return the parts of a control step and their products with the transposed Jacobians, of any parameters."""
        p, wind, loop = (
            ca.SX.sym(*pair)
            for pair in (("p", PARAMETERS_SIZE), ("wind", self.sizes["blown"]), ("loop", self.sizes["loop"]))
        )
        x = arguments["x"]
        force, air = self.drag(x, wind, p)
        move = self.substep(x, arguments["acting"], arguments["force"], arguments["air"], p, loop)
        functions = [
            ("drag", {"x": x, "wind": wind, "p": p}, {"force": force, "air": air}, ["x"]),
            ("move", {**arguments, "p": p, "loop": loop}, {"x": move}, ["x", "acting", "force"]),
            ("outputs", {"x": x}, {"euler": self.outputs(x)}, ["x"]),
        ]
        text = ""
        for name, given, results, wanted in functions:
            text += self._c(name, None, given, **results)
            first = next(iter(results.values()))
            bar = ca.SX.sym("bar", first.numel())
            product = {key: ca.gradient(ca.dot(first, bar), given[key]) for key in wanted}
            text += self._c(f"{name}_back", None, {**given, "bar": bar}, **product)
        return text
