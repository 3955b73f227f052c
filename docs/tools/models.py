"""Draw the figures of docs/models.md: ``python -m docs.tools.models``, with seed 1.

With arguments, such as ``dryden``, JSON with a kind or ``mine:MyWind``, only these models are drawn, into results/wind.
A wind is drawn as a time series, a histogram and a spectrum. Sensors and actuators are drawn as a
signal before and after the model.
"""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal

from quadpend_gym import Simulation
from quadpend_gym.actuators import KINDS as ACTUATORS
from quadpend_gym.actuators import GyroBias, as_actuators
from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.factories import is_factory
from quadpend_gym.core.files import parse_mapping
from quadpend_gym.core.models import ModelBatch
from quadpend_gym.core.settings import suggest
from quadpend_gym.core.streams import WIND_STREAM, Streams
from quadpend_gym.physics.drag import AIR_DENSITY
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, POSITION, STATE_SIZE, State
from quadpend_gym.scenarios import find_scenario
from quadpend_gym.sensors import KINDS as SENSORS
from quadpend_gym.sensors import as_sensors
from quadpend_gym.vehicles import CONTROL_PERIOD, VEHICLES
from quadpend_gym.wind import KINDS, PRESETS, SAMPLE_SIZE, WIND_FIELDS, as_wind
from quadpend_train.common.files import atomic
from quadpend_train.reports.figures import COLOURS

_PERIOD = CONTROL_PERIOD
# Episodes, seconds and samples per segment from which histogram and spectrum are computed.
_EPISODES, _SPECTRUM_SECONDS, _WELCH_SEGMENT = 24, 62.0, 2048
_UNITS = {"force": "N", "bob_force": "N", "torque": "N·m", "velocity": "m/s"}

# Models in docs/models.md, by the name of their picture.
GALLERY = {
    "ornstein_uhlenbeck": '{"kind": "ornstein_uhlenbeck", "force": 0.3}',
    "dryden": "dryden",
    "noise": '{"kind": "noise", "position": {"white": 0.001, "bias": 0.003}, "direction": {"quantum": 0.01}}',
    "sample_hold": '{"kind": "sample_hold", "period": 0.1}',
    "motor_lag": "motor_lag",
}


def draw(title: str, name: str, seconds: float, seed: int, path: Path) -> None:
    """Draw a model into a PNG file.

    Args:
        title: Title of the picture.
        name: Preset or kind of wind, kind of sensor or actuator (with default settings), JSON with a ``kind``, or the
            file of a scenario or ``"module:factory"``, whose wind is drawn.
        seconds: Length of the time series, s.
        seed: Seed of the episode in the time series.
        path: Path of the picture.

    Raises:
        ValueError: If `name` is none of these, or the wind is always zero.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    category, models = _find(name)
    figure = Figure(figsize=(9.0, 5.2 if category == "wind" else 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title.replace("_", " "), fontsize=11)
    _DRAW[category](figure, models, seconds, seed)
    with atomic(path) as unfinished:
        figure.savefig(unfinished, dpi=80)


def _find(name: str) -> tuple[str, tuple[Any, ...]]:
    """Return the category ("wind", "sensors" or "actuators") and the models with this name."""
    if name.lstrip().startswith("{"):
        data = parse_mapping(name, "the model")
    elif name in PRESETS:
        return "wind", as_wind(name)
    elif is_factory(name) or Path(name).suffix in (".toml", ".json"):
        return "wind", find_scenario(name).wind_models
    else:
        data = {"kind": name}
    for category, (kinds, as_models) in _CATEGORIES.items():
        if data.get("kind") in kinds:
            return category, as_models(data)
    known = [*PRESETS, *(kind for kinds, _ in _CATEGORIES.values() for kind in kinds if kind != "sum")]
    raise ValueError(
        f"there is no model {name!r}{suggest(name, known)}; there are {', '.join(known)}; or give JSON with a kind"
    )


def _time_series(models: tuple[Any, ...], steps: int, seed: int) -> Floats:
    """Return the wind in the first episodes of environments with the seeds from `seed`, (steps, _EPISODES, 16)."""
    batch, out = ModelBatch(models, _EPISODES), np.zeros((steps, SAMPLE_SIZE, _EPISODES)).swapaxes(1, 2)
    streams = Streams.from_seeds([*range(seed, seed + _EPISODES)]).derive(0).derive(WIND_STREAM)
    for step, values in enumerate(out):
        clock = np.full(_EPISODES, step)

        def sample(model: Any, memory: Floats, own: Streams, out: Floats = values, clock: Integers = clock) -> None:
            model.sample(out, memory, clock, _PERIOD, own)

        if step == 0:
            batch.start_episodes(np.arange(_EPISODES), streams, sample)
        else:
            batch.apply(sample)
    return out


def _draw_wind(figure: Any, models: tuple[Any, ...], seconds: float, seed: int) -> None:
    """Draw the time series of one episode, and histogram and spectrum of many episodes."""
    wind = _time_series(models, round(max(seconds, _SPECTRUM_SECONDS) / _PERIOD), seed)
    if models and not wind.any():
        raise ValueError("the wind is always zero: set its loads, as JSON with a kind")
    order = ("velocity", "force", "bob_force", "torque")
    field = next((name for name in order if wind[..., WIND_FIELDS[name]].any()), "force")
    columns = WIND_FIELDS[field]
    grid = figure.add_gridspec(2, 2)
    time = _PERIOD * np.arange(round(seconds / _PERIOD))
    above, histogram, spectrum = (figure.add_subplot(place) for place in (grid[0, :], grid[1, 0], grid[1, 1]))
    frequency, density = signal.welch(wind[..., columns], 1.0 / _PERIOD, nperseg=_WELCH_SEGMENT, noverlap=0, axis=0)
    omega = 2.0 * np.pi * frequency[1:]
    for i, axis in enumerate("xyz"):
        values, colour = wind[..., columns][..., i], COLOURS[i]
        if not values.any():
            continue
        above.plot(time, values[: time.size, 0], color=colour, linewidth=1.0, label=axis)
        histogram.hist(values.ravel(), 40, density=True, histtype="step", color=colour)
        spectrum.loglog(omega, density[1:, :, i].mean(axis=1) / (2.0 * np.pi), color=colour, linewidth=1.0)
    unit = _UNITS[field]
    words = field.replace("_", " ")
    above.set(xlabel="time (s)", ylabel=f"{words} ({unit})", xlim=(0.0, seconds))
    if above.lines:
        above.margins(y=0.2)
        above.legend(frameon=False, ncols=3, loc="upper right")
    if field == "velocity":
        _force_axis(above)
    histogram.set(xlabel=f"{words} ({unit})", ylabel="density")
    spectrum.set(xlabel="frequency (rad/s)", ylabel=f"({unit})² per rad/s", xlim=(omega[0], 100.0))
    spectrum.set_ylim(bottom=max(spectrum.get_ylim()[0], 1e-9 * spectrum.get_ylim()[1]))
    if density[1:].max() < 1e-12:
        spectrum.set(title="constant: no spectrum", ylim=(1e-6, 1.0))
    for axes in (above, histogram, spectrum):
        axes.grid(alpha=0.3)


def _force_axis(axes: Any) -> None:
    """Add a second scale: the drag of this wind on a quadrotor at rest."""
    factor = 0.5 * AIR_DENSITY * Simulation().parameters.quadrotor_drag_area
    force = axes.secondary_yaxis(
        "right",
        functions=(lambda v: factor * np.abs(v) * v, lambda f: np.sign(f) * np.sqrt(np.abs(f) / factor)),
    )
    force.set_ylabel("drag on the quadrotor (N)")


def _apply(models: tuple[Any, ...], values: Floats, seed: int, call: Callable[..., None]) -> Floats:
    """Apply models to a signal, shape (steps, k).

    Args:
        models: Models in their order.
        values: The signal, shape (steps, k).
        seed: Seed of the random stream.
        call: Function that applies one model; its arguments are sample, step, model, memory and streams.
    """
    batch, out = ModelBatch(models, 1), np.empty(values.shape)
    row, streams = np.zeros(1, np.int64), Streams.from_seeds([seed])
    batch.start_episodes(row, streams, lambda *_: None)
    for k, value in enumerate(values):
        sample = np.array(value[np.newaxis], order="F")
        batch.apply(partial(call, sample, row + k))
        out[k] = sample[0]
    return out


def _draw_sensors(figure: Any, models: tuple[Any, ...], seconds: float, seed: int) -> None:
    """Draw an oscillating position and direction, true and measured."""
    seconds = min(seconds, 3.0)
    time = np.arange(0.0, seconds, _PERIOD)
    true = np.zeros((time.size, STATE_SIZE))
    state = State(true)
    state.position[:, 0], state.direction[:, 0] = 0.02 * np.sin(2.0 * time), np.sin(0.05 * np.sin(4.0 * time))
    state.direction[:, 2] = np.sqrt(1.0 - state.direction[:, 0] ** 2)

    def sense(sample: Floats, step: Integers, model: Any, memory: Floats, streams: Streams) -> None:
        model.sense(sample, memory, step, _PERIOD, streams)

    measured = _apply(models, np.pad(true, ((0, 0), (0, 1))), seed, sense)  # with the age of the sample
    for axes, column, label in zip(
        figure.subplots(1, 2), (POSITION, DIRECTION), ("position x (m)", "direction r_x"), strict=True
    ):
        axes.step(time, measured[:, column], where="post", color=COLOURS[1], linewidth=0.8, label="measured")
        axes.plot(time, true[:, column], color=COLOURS[0], linewidth=1.5, label="true")
        axes.set(xlabel="time (s)", ylabel=label, xlim=(0.0, seconds))
        axes.margins(y=0.2)
        axes.grid(alpha=0.3)
        axes.legend(frameon=False, ncols=2, loc="upper right")


def _draw_actuators(figure: Any, models: tuple[Any, ...], seconds: float, seed: int) -> None:
    """Draw pulses on the components of the action, one after the other, and the resulting components."""
    time = np.arange(0.0, 1.0, _PERIOD)
    action = np.zeros((time.size, ACTION_SIZE))
    for i in range(ACTION_SIZE):
        action[10 + 22 * i : 22 + 22 * i, i] = 0.5

    needs_rates = any(isinstance(model, GyroBias) for model in models)
    simulation = Simulation(VEHICLES["hummingbird"], "body_rates") if needs_rates else Simulation()

    def act(sample: Floats, step: Integers, model: Any, memory: Floats, streams: Streams) -> None:
        model.act(sample, memory, step, simulation, streams)

    acted = _apply(models, action, seed, act)
    for axes, values, title in zip(
        figure.subplots(1, 2, sharey=True),
        (action, acted),
        ("action", "result: thrust, roll, pitch, yaw"),
        strict=True,
    ):
        for i in range(ACTION_SIZE):
            axes.step(time, values[:, i], where="post", color=COLOURS[i], linewidth=1.2, label=f"a{'₀₁₂₃'[i]}")
        axes.set(xlabel="time (s)", title=title, ylim=(-0.1, 0.7))
        axes.grid(alpha=0.3)
        axes.legend(frameon=False, ncols=4, loc="upper center", fontsize=8)


_CATEGORIES: dict[str, tuple[Any, Callable[[Any], tuple[Any, ...]]]] = {
    "wind": (KINDS, as_wind),
    "sensors": (SENSORS, as_sensors),
    "actuators": (ACTUATORS, as_actuators),
}
_DRAW: dict[str, Callable[[Any, tuple[Any, ...], float, int], None]] = {
    "wind": _draw_wind,
    "sensors": _draw_sensors,
    "actuators": _draw_actuators,
}


def main() -> None:
    """Draw all models of the page, or those that are named on the command line."""
    named = {f"model_{i}" if not name.isidentifier() else name: name for i, name in enumerate(sys.argv[1:])}
    folder = Path("results/wind") if named else Path(__file__).parents[1] / "models"
    folder.mkdir(parents=True, exist_ok=True)
    for name, model in (named or GALLERY).items():
        draw(name, model, 10.0, 1, folder / f"{name}.png")
        print(f"Written: {folder / name}.png")


if __name__ == "__main__":
    main()
