"""Senders of samples for `quadpend fly`, to copy: from Vicon, OptiTrack and Qualisys, each by its own package.

None was tested with its system. Each has two rigid bodies: the vehicle, with its origin at the centre of mass, x
forward and y left, and the pole, whose z axis points from foot to top. The world's z is up.

    python motion_capture.py qualisys 192.168.0.10
"""

import asyncio
import atexit
import socket
import struct
import sys
import time
from collections.abc import Sequence
from itertools import count

import numpy as np
from scipy.spatial.transform import Rotation

TO = ("127.0.0.1", 9101)  # the computer of `quadpend fly`
BODIES = ("vehicle", "pole")  # names, or OptiTrack's streaming ids 1 and 2
_socket, _counter = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), count()
atexit.register(_socket.close)


def send(exposure: float, position: Sequence[float], vehicle: Rotation, pole: Rotation) -> None:
    """Send a sample: time (s), position (m), and the attitudes of both bodies, body to world."""
    numbers = *position, *vehicle.as_quat(scalar_first=True), *pole.apply([0.0, 0.0, 1.0])
    _socket.sendto(struct.pack("<4sI11d", b"QPM1", next(_counter) % 2**32, exposure, *numbers), TO)


def vicon(host: str) -> None:
    """Vicon's DataStream SDK, vicon_dssdk: mm, quaternions x, y, z, w; the segment has the name of its subject."""
    from vicon_dssdk import ViconDataStream

    client = ViconDataStream.Client()
    client.Connect(f"{host}:801")
    client.EnableSegmentData()
    client.SetStreamMode(ViconDataStream.Client.StreamMode.EServerPush)
    while client.GetFrame():
        turned = [Rotation.from_quat(client.GetSegmentGlobalRotationQuaternion(name, name)[0]) for name in BODIES]
        position, is_hidden = client.GetSegmentGlobalTranslation(BODIES[0], BODIES[0])
        if not is_hidden:
            send(time.monotonic() - client.GetLatencyTotal(), np.multiply(1e-3, position).tolist(), *turned)


def optitrack(host: str) -> None:
    """OptiTrack's NatNet SDK, NatNetClient.py: m, quaternions x, y, z, w; set Motive's up axis to Z."""
    from NatNetClient import NatNetClient

    client, seen = NatNetClient(), {}
    client.set_server_address(host)
    client.rigid_body_listener = lambda number, position, rotation: seen.update({number: (position, rotation)})
    client.new_frame_listener = lambda _: send(
        time.monotonic(), seen[1][0], Rotation.from_quat(seen[1][1]), Rotation.from_quat(seen[2][1])
    )
    client.run()


async def qualisys(host: str) -> None:
    """Qualisys' qtm_rt: mm, matrices by columns; the vehicle is the first body of QTM, the pole the second."""
    import qtm_rt

    def take(packet: qtm_rt.QRTPacket) -> None:
        (position, vehicle), (_, pole) = packet.get_6d()[1][:2]
        turned = [Rotation.from_matrix(np.reshape(one.matrix, (3, 3), order="F")) for one in (vehicle, pole)]
        send(1e-6 * packet.timestamp, np.multiply(1e-3, position).tolist(), *turned)

    connection = await qtm_rt.connect(host)
    await connection.stream_frames(components=["6d"], on_packet=take)
    await asyncio.Event().wait()


if __name__ == "__main__":
    made = {"vicon": vicon, "optitrack": optitrack, "qualisys": qualisys}[sys.argv[1]](sys.argv[2])
    if made is not None:
        asyncio.run(made)
