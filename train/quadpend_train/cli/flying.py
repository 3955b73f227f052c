"""The commands about real flights: `fly`, and `simulate` for a flight on the desk."""

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Literal

import tyro

from quadpend_gym.core.settings import Range
from quadpend_train.cli.options import Seed

Angle = Annotated[float, Range(0.0, 3.15, "rad")]
Length = Annotated[float, Range(0.0, 1e4)]


def fly(
    policy: tyro.conf.Positional[Path],
    to: str,
    source: Annotated[str, tyro.conf.arg(name="from")] = "0.0.0.0:9101",
    vehicle: str | None = None,
    log: Path = Path("flight.csv"),
    thrust: Path | None = None,
    voltage: Annotated[float, Range(0.0, 100.0, "V")] = 0.0,
    age: Annotated[float, Range(0.0, 0.3, "s")] = 0.15,
    pole_tilt: Angle = 0.785,
    body_tilt: Angle = 1.05,
    distance: Length = 0.5,
    height: Annotated[tuple[float, float], Range(-1e4, 1e4, "m")] = (0.0, 10.0),
    speed: Length = 5.0,
    step: Annotated[float, Range(0.0, 10.0, "m")] = 0.5,
    fence: Length = 2.0,
) -> None:
    """Fly a vehicle: motion capture by UDP, a policy in C with its supervisor, an autopilot by MSP.

    Keys arm, hold, fly, move the set point and disarm; any other key kills. docs/first-flight.md has their order.

    Args:
        policy: C file that `quadpend export` has written.
        to: The autopilot: msp:HOST:PORT, msp:/dev/ttyACM0, or module:function of your own.
        source: Address at which samples of motion capture arrive.
        vehicle: Preset or TOML file with the rates and the thrusts of the autopilot; default: that of the policy.
        log: New CSV file for motion capture, motors, commands and status. NAME.toml beside it is for identify.
        thrust: TOML file of throttles, voltages and the measured thrusts of a rotor; default: linear in the throttle.
        voltage: Of the battery, for the file of thrusts, V.
        age: Time without a usable sample that kills, s.
        pole_tilt: Tilt of the pole that kills, from upright, rad.
        body_tilt: Tilt of the body that kills, from level, rad.
        distance: Of the tracked point from its reference that kills, m.
        height: Lowest and highest height of the vehicle's centre, m; beyond it is killed.
        speed: Of the vehicle's centre that kills, m/s.
        step: Distance by which a key moves the set point, m.
        fence: Horizontal distance from where the flight began that kills, m.
    """
    import socket

    from quadpend_gym.core.files import read_toml
    from quadpend_gym.core.settings import parse
    from quadpend_gym.vehicles import Simulation
    from quadpend_gym.vehicles.vehicle import as_vehicle
    from quadpend_train.links import flight
    from quadpend_train.links.autopilots import listen, open_link
    from quadpend_train.links.msp import linear
    from quadpend_train.links.supervised import Supervised
    from quadpend_train.links.terminal import keys_at_once, prefer
    from quadpend_train.links.thrust import ThrustTable
    from quadpend_train.policies.compiled import SupervisedPolicy

    if (thrust is None) != (voltage == 0.0):
        raise ValueError("--thrust needs --voltage, and --voltage needs --thrust")
    if height[0] >= height[1]:
        raise ValueError(f"--height must be the lowest and the highest height, not {height[0]:g} {height[1]:g}")
    designed = SupervisedPolicy(policy).designed  # from its header: compiling takes seconds
    if designed["INTERFACE"] != "body_rates":
        raise ValueError(f"{policy} commands {designed['INTERFACE']}; an autopilot takes body_rates")
    name, written = designed["VEHICLE"], f"{policy} was written for the vehicle {designed['VEHICLE']}"
    try:
        simulation = Simulation(vehicle=as_vehicle(vehicle or name), interface="body_rates")
    except ValueError as error:
        if vehicle:
            raise
        raise ValueError(f"{written}, which is no preset: give its file, such as --vehicle {name}.toml") from error
    if simulation.vehicle.name != name:
        raise ValueError(f"{written}, not {simulation.vehicle.name}: export it with --vehicle")
    period, latency = float(designed["PERIOD"]), float(designed["LATENCY"])
    if latency == 0.0:
        raise ValueError(f"{policy} was written for no latency, which no flight has: export it with yours by --latency")
    columns = log.with_suffix(".toml")
    if columns.exists():
        raise FileExistsError(f"{columns} exists already: choose another name with --log")
    flown = Supervised(policy)
    limits = {"age": age, "pole_tilt": pole_tilt, "body_tilt": body_tilt, "distance": distance, "speed": speed}
    for field, value in {**limits, "lowest": height[0], "highest": height[1]}.items():
        setattr(flown.fields, field, value)
    curve = linear(simulation) if thrust is None else parse(ThrustTable, read_toml(thrust), "thrust").at(voltage)
    with listen(source, socket.SOCK_DGRAM) as samples:
        link = open_link(to, simulation, curve)
        if not prefer():
            print("Warning: the system gives no real-time priority; see docs/first-flight.md", file=sys.stderr)
        print(
            f"{flown.name} for {simulation.vehicle.name}: {1.0 / period:g} Hz, latency of {1e3 * latency:g} ms from the"
            " exposure to the autopilot"
        )
        print(flight.HELP, flush=True)
        with keys_at_once():
            summary = flight.fly(flown, samples, link, curve, log, step, fence)
    print(end="\n" if sys.stdout.isatty() else "")
    for sentence in summary.sentences():
        print(f"{sentence}.")
    begin, end = summary.flown
    if end > begin:
        columns.write_text(flight.IDENTIFIED.format(log=log.name, begin=begin, end=end), encoding="utf-8")
    print("Written:", log, *[columns] * (end > begin))
    if summary.cause:
        sys.exit(1)


def simulate(
    to: str = "127.0.0.1:9101",
    listen: str = "127.0.0.1:9100",
    scenario: str = "flight_breeze",
    vehicle: str | None = None,
    seed: Seed = 0,
    rate: Annotated[float, Range(10.0, 500.0, "1/s")] = 100.0,
    delay: Annotated[float, Range(0.0, 1.0, "s")] = 0.017,
    autopilot: Literal["direct", "betaflight"] = "direct",
    blackbox: Path | None = None,
) -> None:
    """Simulate a vehicle with its pole in real time, for a flight on the desk.

    It sends samples of motion capture by UDP, and takes channels by MSP over TCP. Body and pole begin in a hand. There
    is no ground.

    Args:
        to: Address to which samples go.
        listen: Address to which `quadpend fly --to msp:127.0.0.1:9100` connects, without firmware.
        scenario: Vehicle, wind and sensors, which must have noise.
        vehicle: Vehicle in place of that of the scenario, as in evaluate.
        seed: Of wind and noise.
        rate: Samples in a second.
        delay: Of the samples, s; the whole latency is about 3 ms longer.
        autopilot: What takes the channels: a receiver without firmware, or Betaflight's firmware, at its port 5761.
        blackbox: New file for the log of Betaflight's firmware, such as flight.bbl.
    """
    import socket

    from quadpend_train.cli.options import named_scenarios
    from quadpend_train.links import autopilots, desk, receivers
    from quadpend_train.links.terminal import keys_at_once, prefer

    every = round(1.0 / (rate * desk.PERIOD))
    if abs(every * rate * desk.PERIOD - 1.0) > 1e-6:
        raise ValueError(f"the rate must be 1000 divided by a whole number, such as 100 or 200, not {rate:g}")
    if blackbox is not None and (blackbox.exists() or autopilot != "betaflight"):
        raise ValueError(f"--blackbox needs --autopilot betaflight and a new file, not {autopilot} and {blackbox}")
    (flown,) = named_scenarios((scenario,), vehicle, "body_rates").values()
    simulated = desk.Desk(flown, seed, "rotors" if autopilot == "betaflight" else "body_rates")
    prefer()
    with ExitStack() as stack:
        made: receivers.Firmware | receivers.Direct
        if autopilot == "betaflight":
            made = stack.enter_context(receivers.Firmware(flown.simulation, [blackbox] if blackbox else []))
        else:
            server = stack.enter_context(autopilots.listen(listen, socket.SOCK_STREAM))
            made = receivers.Direct(server, flown.simulation)
        stack.enter_context(keys_at_once())
        print(desk.run(simulated, made, autopilots.parse_address(to), every, delay))
