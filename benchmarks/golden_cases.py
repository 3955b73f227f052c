"""What the golden hashes cover: environments, flights and trainings by name, as tables of plain data.

A table has the parts of an environment or a scenario by the names of `gymnasium.make` and of `quadpend_gym.Scenario`.
Only the functions of `golden` call the packages.
"""

from itertools import product
from typing import Any

Parts = dict[str, Any]

IDS = {name: f"QuadPendulum{name}-v0" for name in ("", "Hover", "SwingUp", "Load", "Recovery")}
TRACK = IDS[""]
WINDS: dict[str, Any] = {
    **{name: name for name in ("calm", "breeze", "windy", "storm", "paper")},
    "constant": {"kind": "constant", "force": (0.1, -0.2, 0.05), "bob_force": 0.01, "torque": (0.0, 0.1, 0.02)},
    "sinusoid": {"kind": "sinusoid", "force": 0.3, "velocity": (2.0, 0.0, 0.5), "frequency": 7.0},
    "gusts": {
        "kind": "gusts",
        "velocity": (8.0, 1.0, 0.0),
        "bob_force": 0.02,
        "pause": (0.0, 0.1),
        "length": (0.2, 0.4),
    },
    "noise": {"kind": "ornstein_uhlenbeck", "force": (0.2, 0.0, 0.1), "torque": 0.05, "time_constant": 0.2},
    "dryden": {"kind": "dryden", "intensity": "severe", "altitude": 30.0, "heading": 0.7},
}
WINDS["drawn"] = {"kind": "drawn", "wind": WINDS["dryden"], "strength": (0.5, 2.0), "heading": (0.0, 1.0)}
WINDS["rescaled"] = {"kind": "rescaled", "wind": WINDS["constant"], "scale": 0.4, "torque_scale": (2.0, 1.0, 0.5)}
WINDS["sum"] = {"kind": "sum", "models": ["storm", WINDS["sinusoid"], WINDS["rescaled"], WINDS["noise"]]}
VEHICLES = ("hummingbird", "crazyflie", "x500")
INTERFACES = ("wrench", "body_rates", "rotors")
LIGHT_WIND = [{"kind": "drawn", "wind": {"kind": "dryden", "intensity": 2.0}}, {"kind": "constant", "force": 0.01}]
NOISE = {
    "kind": "noise",
    "position": {"white": 0.001, "bias": 0.002, "walk": 0.001},
    "velocity": 0.01,
    "direction": 0.001,
    "euler": {"quantum": 0.001},
}
SENSORS = [
    NOISE,
    {"kind": "delay", "steps": 3},
    {"kind": "dropout", "probability": 0.3},
    {"kind": "sample_hold", "period": 0.03},
]
ACTUATORS = [
    {"kind": "action_delay", "steps": 2},
    {"kind": "motor_lag", "time_constant": 0.02},
    {"kind": "rate_limit", "rate": 8.0},
    {"kind": "packet_loss", "probability": 0.2},
]
RANGES: dict[str, Any] = {
    "around": {"share": 0.2},
    "ranges": {"quadrotor_mass": (0.4, 0.6), "rod_length": (0.2, 0.5), "bob_drag_area": (0.0, 0.002)},
}
EVERYTHING = {
    "wind": "storm",
    "sensors": SENSORS,
    "actuators": ACTUATORS,
    "parameters": RANGES["around"],
    "observation": "output_feedback",
    "history": (2, 0),
}
FAMILIES = {"hover": 0.0, "slalom": 2.0, "acceleration": (1.0, 3.0), "speed": (0.5, 1.0), "yaw_amplitude": 0.5}
RATES = {"vehicle": "hummingbird", "interface": "body_rates"}
RIGID_EVERYTHING = {**EVERYTHING, **RATES, "latency": 0.015, "wind": LIGHT_WIND}
# Long episodes, since some winds come late
LONG_LOAD = {"env_id": IDS["Load"], "actions": 0.01, "max_episode_steps": 240, "steps": 260}

# Parts of environments by name; what an environment does not give is in `DEFAULTS`. "actions" is the
# standard deviation of random actions.
ENVIRONMENTS: dict[str, Parts] = {
    **{f"{env_id}, everything": {"env_id": env_id, **EVERYTHING} for env_id in IDS.values()},
    **{f"{env_id}, hummingbird, everything": {"env_id": env_id, **RIGID_EVERYTHING} for env_id in IDS.values()},
    **{f"load in the wind {name}": {**LONG_LOAD, "wind": wind} for name, wind in WINDS.items()},
    **{
        f"{vehicle}, {interface}, latency {latency} s": {
            "vehicle": vehicle,
            "interface": interface,
            "latency": latency,
            "wind": LIGHT_WIND,
        }
        for vehicle, interface, latency in product(VEHICLES, INTERFACES, (0.0, 0.015))
    },
    "sensor: all sensors": {"sensors": SENSORS},
    "actuator: gyro bias": {**RATES, "actuators": {"kind": "gyro_bias", "deviation": 0.3}},
    **{f"parameters: {name}": {"parameters": ranges, "wind": "storm"} for name, ranges in RANGES.items()},
    "observation: history": {"history": (3, 2)},
    "600 rows, everything": {"num_envs": 600, **EVERYTHING},
}
DEFAULTS: Parts = {"env_id": TRACK, "num_envs": 37, "max_episode_steps": 50, "steps": 120, "actions": 0.15}

LAGGED = [{"kind": "action_delay", "steps": 1}, {"kind": "motor_lag", "time_constant": 0.02}]
# Parts of scenarios by name, grouped by the policies that can fly them.
PAPER: dict[str, Parts] = {
    "windy": {"wind": "windy"},
    "storm, lagged": {"wind": "storm", "actuators": LAGGED},
    "breeze, output feedback": {"wind": "breeze", "observation": "output_feedback"},
    "fast": {"task": {"references": FAMILIES}},
}
HUMMINGBIRD: dict[str, Parts] = {
    "hummingbird, as flown": {
        **RATES,
        "task": "hover",
        "period": 0.02,
        "substeps": 8,
        "latency": 0.03,
        "actuators": [{"kind": "packet_loss", "probability": 0.01}, {"kind": "gyro_bias", "deviation": 0.02}],
        "sensors": NOISE,
        "observation": "output_feedback",
    },
}
LAB: dict[str, Parts] = {f"{name}, lab": {**parts, "observation": "lab"} for name, parts in HUMMINGBIRD.items()}
RIGID: dict[str, Parts] = {
    "crazyflie, rotors": {"wind": "breeze", "vehicle": "crazyflie", "interface": "rotors"},
    "x500, wrench": {"wind": "windy", "vehicle": "x500", "interface": "wrench"},
}
LOAD: dict[str, Parts] = {
    "load, windy": {"task": "load", "wind": "windy"},
    "load, upset": {
        "task": {"pendulum": "hanging", "start": {"pendulum_angle": (0.3, 0.8)}},
        "period": 0.04,
        "substeps": 8,
    },
}
SWING_UP: dict[str, Parts] = {
    "swing-up, breeze": {"task": "swing_up", "wind": "breeze", "duration": 4.0},
    "recovery": {"task": "recovery", "duration": 4.0},
}
CLASSICAL = PAPER | HUMMINGBIRD | RIGID
# Scenarios of each policy; a learned policy has its name without the seed.
FLIGHTS: dict[str, dict[str, Parts]] = {
    **dict.fromkeys(("adrc-paper", "adrc-matched", "adrc-tuned", "adrc-linear", "nmpc"), CLASSICAL),
    **dict.fromkeys(("flatness", "lqr", "lqi", "dual-mode"), CLASSICAL | LOAD),
    "lqg": CLASSICAL,
    "swing-up": {**SWING_UP, **RIGID},
    **dict.fromkeys(("apg", "ppo-alone", "sac-alone"), PAPER),
    **dict.fromkeys(("apg-flight", "ppo-flight", "apg-loops", "apg-vehicles-safe"), HUMMINGBIRD),
    "lab": LAB,
    **dict.fromkeys(("ppo-swing-up", "ppo-swing-up-wind"), SWING_UP),
}
LEARNED = ("apg", "lab", "ppo-", "sac-")  # beginnings of their names
EPISODES = {"nmpc": 2}  # of each flight; the actions of `nmpc` take milliseconds
SECONDS, LONG = 2.0, 3.0  # of an episode whose parts have no duration, and of one in a scenario of the package

BRIEF: Parts = {
    "scenarios": ["windy"],
    "total_timesteps": 1024,
    "num_envs": 16,
    "n_eval_episodes": 2,
}
# Arguments of the algorithms
_NETWORK = {"net_arch": [16]}
_REPLAY = {
    **{"gradient_steps": 1, "buffer_size": 1024, "learning_starts": 64, "batch_size": 32, "gamma": 0.995},
    **{"learning_rate": {"initial": 2e-3, "final": 4e-5}, "policy_kwargs": _NETWORK},
}
ALGORITHMS: dict[str, Parts] = {
    "ppo": {"n_steps": 16, "n_epochs": 2, "batch_size": 128, "policy_kwargs": _NETWORK},
    "sac": _REPLAY,
    "tqc": _REPLAY,
    "apg": {"window": 8, **_NETWORK},
}
# Settings in which each training differs from `BRIEF`.
TRAININGS: dict[str, Parts] = {
    "ppo": {},
    "ppo with gSDE": {
        "ppo": {
            **ALGORITHMS["ppo"],
            **{"use_sde": True, "sde_sample_freq": 4, "policy_kwargs": {**_NETWORK, "activation_fn": "tanh"}},
        },
        "reward": {"tip": 0.2},
    },
    "ppo with checkpoints": {"save_freq": 256},
    "ppo on the DESO's estimates": {"hybrid": {"base_controller": "adrc-matched"}},
    "ppo after imitation": {"hybrid": {"base_controller": "flatness", "imitation_timesteps": 640}},
    "ppo with a residual and a relative reward": {
        "hybrid": {
            "base_controller": "flatness",
            "baseline_relative_reward": True,
            "mode": "residual_action",
        },
        "max_episode_steps": 20,
        "critic_warmup_steps": 256,
    },
    "sac": {"algo": "sac", "total_timesteps": 512},
    "tqc": {"algo": "tqc", "total_timesteps": 512},
    "apg": {"algo": "apg", "scenarios": ["training_uncertain", "training_lagged"]},
}
