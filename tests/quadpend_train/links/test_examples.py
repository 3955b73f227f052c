"""The links and senders to copy: what they send is right for the libraries' own parsers, where these are installed."""

import socket
import struct
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from docs.examples import crazyflie, mavlink, motion_capture
from quadpend_gym.scenarios import find_scenarios
from quadpend_gym.vehicles import rotors_of
from quadpend_train.links.autopilots import Link
from quadpend_train.links.motion_capture import Sample, unpack

SIMULATION = find_scenarios(["flight_breeze"])["flight_breeze"].simulation
LOW, HIGH = rotors_of(SIMULATION.vehicle).thrust
COMMAND = np.array([4.0 * (LOW + 0.25 * (HIGH - LOW)), 1.0, -2.0, 0.5])


class Recorder:
    """Records the calls of any method, of any part."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, Any]] = []

    def __getattr__(self, name: str) -> Any:
        if name in ("mav", "param", "commander"):
            return self
        return lambda *arguments: self.calls.append((name, arguments))


def test_a_mavlink_link_sends_rates_in_forward_right_down() -> None:
    recorder = Recorder()
    link: Link = mavlink.Mavlink(SIMULATION, recorder)
    for is_armed in (True, False):
        link.send(COMMAND, is_armed)
    sent = [arguments[3:] for _, arguments in recorder.calls]
    assert [s[:5] for s in sent] == [(128, [1, 0, 0, 0], 1.0, 2.0, -0.5)] * 2
    assert [s[5] for s in sent] == pytest.approx([0.25, 0.0])
    assert link.silence() == 0.0
    assert np.isnan(link.motors()).all()
    link.close()


def test_a_crazyflie_link_sends_degrees_and_16_bits() -> None:
    recorder = Recorder()
    link: Link = crazyflie.Crazyflie(SIMULATION, recorder)
    for is_armed in (True, False):
        link.send(COMMAND, is_armed)
    sent = [arguments for name, arguments in recorder.calls if name == "send_setpoint"]
    assert sent[0] == pytest.approx((*np.degrees(COMMAND[1:] * (1.0, 1.0, -1.0)), 16383), abs=1.0)
    assert sent[1][3] == 0
    assert next(arguments for name, arguments in recorder.calls if name == "set_value") == (
        "flightmode.stabModeRoll",
        "0",
    )
    assert link.silence() == 0.0
    assert np.isnan(link.motors()).all()
    link.close()


def test_pymavlink_reads_the_bytes() -> None:
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    from pymavlink.dialects.v20 import common

    written: list[bytes] = []
    writer = common.MAVLink(SimpleNamespace(write=written.append))
    mavlink.Mavlink(SIMULATION, SimpleNamespace(mav=writer)).send(COMMAND, True)
    (message,) = common.MAVLink(None).parse_buffer(b"".join(written))
    assert message.get_type() == "SET_ATTITUDE_TARGET"
    found = message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate, message.thrust
    assert found == pytest.approx((1.0, 2.0, -0.5, 0.25), abs=1e-6)
    assert message.type_mask == 128


def test_cflib_makes_a_packet() -> None:
    pytest.importorskip("cflib", reason="cflib is not installed")
    from cflib.crazyflie.commander import Commander

    packets: list[Any] = []
    flown = SimpleNamespace(send_packet=packets.append, param=Recorder())
    flown.commander = Commander(flown)
    crazyflie.Crazyflie(SIMULATION, flown).send(COMMAND, True)
    *angles, thrust = struct.unpack("<fffH", bytes(packets[-1].data))
    assert angles == pytest.approx(np.degrees([1.0, 2.0, -0.5]))  # the library negates the pitch
    assert thrust == pytest.approx(16383, abs=1)


@pytest.fixture
def receiver(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A socket that gets what the senders send."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        found.settimeout(5.0)
        monkeypatch.setattr(motion_capture, "TO", found.getsockname())
        yield found


TURNED, LEANING = Rotation.from_euler("z", 0.5), Rotation.from_euler("y", 0.1)


def check(sample: Sample) -> None:
    """Whether a sample is of the vehicle at (1, 2, 3) m that is turned, and of the pole that leans."""
    assert sample.position == pytest.approx((1.0, 2.0, 3.0))
    assert sample.quaternion == pytest.approx((np.cos(0.25), 0.0, 0.0, np.sin(0.25)))
    assert sample.direction == pytest.approx((np.sin(0.1), 0.0, np.cos(0.1)))


def test_the_sender_of_vicon_converts_its_units_and_order(
    receiver: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = iter([True, False])
    attitudes = {"vehicle": TURNED.as_quat().tolist(), "pole": LEANING.as_quat().tolist()}
    client = SimpleNamespace(
        Connect=lambda _: None,
        EnableSegmentData=lambda: None,
        SetStreamMode=lambda _: None,
        GetFrame=lambda: next(frames),
        GetLatencyTotal=lambda: 0.01,
        GetSegmentGlobalRotationQuaternion=lambda name, _: (attitudes[name], False),
        GetSegmentGlobalTranslation=lambda *_: ((1000.0, 2000.0, 3000.0), False),
    )
    made = type("Client", (), {"__new__": lambda _: client, "StreamMode": SimpleNamespace(EServerPush=1)})
    library = SimpleNamespace(ViconDataStream=SimpleNamespace(Client=made))
    monkeypatch.setitem(sys.modules, "vicon_dssdk", library)  # type: ignore[arg-type]
    motion_capture.vicon("host")
    check(unpack(receiver.recv(200)))


def test_the_sender_of_optitrack_converts_its_order(receiver: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    class Client:
        rigid_body_listener: Any
        new_frame_listener: Any

        def set_server_address(self, _: str) -> None:
            pass

        def run(self) -> None:
            self.rigid_body_listener(1, (1.0, 2.0, 3.0), TURNED.as_quat().tolist())
            self.rigid_body_listener(2, (0.0, 0.0, 0.0), LEANING.as_quat().tolist())
            self.new_frame_listener({})

    monkeypatch.setitem(sys.modules, "NatNetClient", SimpleNamespace(NatNetClient=Client))  # type: ignore[arg-type]
    motion_capture.optitrack("host")
    check(unpack(receiver.recv(200)))
