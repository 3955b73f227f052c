"""Bytes of motion capture and of MSP are those of their documents, whatever arrives."""

import os
import socket
import struct
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_gym.autopilots.firmware import find_binary
from quadpend_gym.scenarios import find_scenarios
from quadpend_train.links.motion_capture import SIZE, Receiver, Sample, pack, unpack
from quadpend_train.links.msp import Message, Reader, channels_of, linear, request, set_raw_rc
from quadpend_train.links.thrust import ThrustTable

SAMPLE = Sample(7, 1.5, (1.0, -2.0, 0.5), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
_RC = 105  # MSP_RC, the firmware's channels after its map
BYTES = bytes.fromhex(  # made by hand
    "51504d31 07000000 000000000000f83f"
    "000000000000f03f 00000000000000c0 000000000000e03f"
    "000000000000f03f 0000000000000000 0000000000000000 0000000000000000"
    "0000000000000000 0000000000000000 000000000000f03f"
)


def test_a_sample_has_the_documented_bytes() -> None:
    assert pack(SAMPLE) == BYTES
    assert unpack(BYTES) == SAMPLE
    assert len(BYTES) == SIZE == 96
    numbers = *SAMPLE.position, *SAMPLE.quaternion, *SAMPLE.direction
    assert struct.pack("<4sI11d", b"QPM1", 7, 1.5, *numbers) == BYTES  # the line for senders
    assert SAMPLE.measurement(0.02).tolist() == [*numbers, 0.02]


def taken(receiver: Receiver, *datagrams: bytes) -> list[Sample]:
    """The samples that one sender brings."""
    return [sample for each in datagrams if (sample := receiver.take(each, "sender", 0.0, False))]


@pytest.mark.parametrize("datagram", [b"", BYTES[:-1], BYTES + b"\0", b"QPM2" + BYTES[4:]])
def test_what_is_no_sample_is_refused_and_counted(datagram: bytes) -> None:
    with pytest.raises(ValueError, match="a sample has 96 bytes and begins with b'QPM1', not"):
        unpack(datagram)
    receiver = Receiver()
    assert taken(receiver, datagram, datagram, BYTES) == [SAMPLE]
    assert receiver.foreign == 2


def test_the_newest_of_lost_late_and_doubled_samples_is_found() -> None:
    receiver, late = Receiver(), [SAMPLE._replace(counter=k % 2**32) for k in range(2**32 - 2, 2**32 + 4)]
    assert taken(receiver, pack(late[0])) == late[:1]
    assert taken(receiver, *map(pack, [late[3], late[2], late[3]])) == late[3:4]  # beyond the last counter
    assert taken(receiver, pack(late[1])) == []
    assert taken(receiver, *map(pack, late[4:])) == late[4:]
    assert (receiver.lost, receiver.late, receiver.foreign) == (2, 3, 0)


def test_a_sample_is_shown_with_the_signs_of_the_frames() -> None:
    assert SAMPLE.shown() == "  at   1.00  -2.00   0.50 m  roll    0 pitch    0 yaw    0  pole   0°"
    turned = SAMPLE._replace(quaternion=(np.cos(0.1), 0.0, np.sin(0.1), 0.0), direction=(0.0, np.sin(0.2), np.cos(0.2)))
    assert "roll    0 pitch   11 yaw    0  pole  11°" in turned.shown()  # nose down


def test_a_message_with_channels_has_the_bytes_of_the_protocol() -> None:
    made = bytes.fromhex("244d3c 08 c8 dc05 dc05 e803 dc05 f2")  # by hand: 8 ^ 200 ^ … ^ 5 = 0xf2
    assert set_raw_rc([1500, 1500, 1000, 1500]) == made
    assert request(1) == bytes.fromhex("244d3c 00 01 01")


@pytest.mark.parametrize("channels", [[1500] * 3, [1500] * 19, [1500, 1500, 0, 1500], [1500, 1500, 2251, 1500]])
def test_channels_that_the_firmware_would_take_for_a_lost_link_are_refused(channels: list[int]) -> None:
    with pytest.raises(ValueError, match="4 to 18 channels of 750 to 2250 µs"):
        set_raw_rc(channels)


def test_replies_are_found_in_pieces_and_between_other_bytes() -> None:
    version, refused = bytes.fromhex("244d3e 03 01 00012e 2d"), bytes.fromhex("244d21 00 c8 c8")
    damaged = version[:-1] + b"\0"
    stream = b"#\r\n$" + version + damaged + b"$M" + request(5) + refused + b"$M>"
    expected = [Message(1, b"\x00\x01\x2e"), Message(200, b"")]
    assert Reader().read(stream) == expected
    reader = Reader()
    assert [message for k in range(len(stream)) for message in reader.read(stream[k : k + 1])] == expected
    rng, reader = np.random.default_rng(0), Reader()
    for _ in range(100):
        reader.read(rng.bytes(97) + b"$M>\xff")
    reader.read(bytes(300))
    assert reader.read(refused)[-1] == expected[1]


def test_channels_have_the_signs_and_the_scale_of_the_firmware() -> None:
    simulation = find_scenarios(["flight_breeze"])["flight_breeze"].simulation
    hover = simulation.command_scale[0]
    channels = channels_of(np.array([hover, 1.0, 2.0, -3.0]), True, simulation, linear(simulation))
    assert len(channels) == 8
    assert channels[:2] == [1500 + round(500 / np.radians(580)), 1500 + round(1000 / np.radians(580))]
    assert channels[3:] == [1500 + round(1500 / np.radians(180)), 2000, 1000, 1000, 1000]
    assert channels_of(np.zeros(4), False, simulation, linear(simulation))[2:5] == [1000, 1500, 1000]
    table = ThrustTable(throttles=(0.0, 0.5, 1.0), voltages=(14.0, 16.0), thrusts=((0.0, 1.0, 3.0), (0.0, 2.0, 4.0)))
    for voltage, throttle in ((14.0, 0.75), (16.0, 0.5), (15.0, 0.5 + 0.5 * 0.5 / 2.0), (99.0, 0.5)):
        channels = channels_of(np.array([8.0, 0.0, 0.0, 0.0]), True, simulation, table.at(voltage))
        assert channels[2] == round(1005 + 995 * throttle)
    assert table.at(14.0).thrust([0.25, 0.75]).tolist() == [0.5, 2.0]
    assert channels_of(np.array([99.0, 0, 0, 0]), True, simulation, table.at(14.0))[2] == 2000


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"throttles": (0.0, 0.5, 0.5)}, "throttles must increase"),
        ({"voltages": (16.0, 14.0)}, "voltages must increase"),
        ({"thrusts": ((0.0, 1.0, 2.0),)}, "a row of 3 numbers, at least 2, for each of 2 voltages"),
        ({"thrusts": ((0.0, 2.0, 1.0), (0.0, 2.0, 4.0))}, "thrusts must increase with the throttle"),
        ({"voltages": (0.0, 14.0)}, "voltages.* from 0.1 to 100 V"),
    ],
)
def test_a_table_that_cannot_be_inverted_is_refused(change: dict[str, object], message: str) -> None:
    table = {"throttles": (0.0, 0.5, 1.0), "voltages": (14.0, 16.0), "thrusts": ((0.0, 1.0, 3.0), (0.0, 2.0, 4.0))}
    with pytest.raises(ValueError, match=message):
        ThrustTable(**{**table, **change})


@pytest.mark.extras
def test_the_firmware_takes_the_channels(tmp_path: Path) -> None:
    """Betaflight's own process, whose clock runs with the samples of its gyro, receives channels on its TCP port."""
    try:
        binary = find_binary(os.environ.get("BETAFLIGHT_SITL"))
    except FileNotFoundError as error:
        pytest.skip(str(error))
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process, reader, channels = subprocess.Popen([binary], cwd=tmp_path, **quiet), Reader(), set()
    given = [1600, 1400, 1200, 1550, 1000, 1000, 1000, 1000]
    expected = (1600, 1400, 1550, 1200, 1000, 1000, 1000, 1000)  # roll, pitch, yaw, throttle, AUX
    rest = *(0.0, 0.0, 0.0), *(0.0, 0.0, -9.80665), *(1.0, 0.0, 0.0, 0.0), *(0.0,) * 6, 101325.0
    try:
        time.sleep(1.5)
        with (
            socket.create_connection(("127.0.0.1", 5761), 5.0) as link,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gyro,
        ):
            link.settimeout(0.001)
            begin = time.monotonic()
            while expected not in channels and (now := time.monotonic() - begin) < 20.0:
                gyro.sendto(struct.pack("<18d", now, *rest), ("127.0.0.1", 9003))
                link.sendall(set_raw_rc(given) + request(_RC))
                with suppress(TimeoutError):
                    for reply in reader.read(link.recv(4096)):
                        channels |= {struct.unpack("<8H", reply.payload[:16])} if reply.command == _RC else set()
    finally:
        process.kill()
        process.wait()
    assert expected in channels
