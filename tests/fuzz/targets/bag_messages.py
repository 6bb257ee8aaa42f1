"""The bag reader on valid ROS 1 bags with damaged messages: wrong lengths, wrong types."""

from __future__ import annotations

from bags import frames_of, messages, written
from bounds import check_call, folder

PARTS = (("/scan", "sensor_msgs/msg/LaserScan"), ("/odom", "nav_msgs/msg/Odometry"), ("/tf", "tf2_msgs/msg/TFMessage"),
         ("/tf_static", "tf2_msgs/msg/TFMessage"), ("/echoes", "sensor_msgs/msg/MultiEchoLaserScan"))  # fmt: skip
"""Topics and types; the first byte of an input selects one for the rest of it."""


def seeds() -> list[bytes]:
    """Return a message of every type."""
    return [bytes([number]) + messages("ros1")[number] for number in range(len(PARTS))]


def swollen() -> list[bytes]:
    """Return messages with 10^9 beams, chains of 1,000 transforms, and many transforms in one message."""
    scan, _, transforms, _, echoes = seeds()
    lie = scan.rindex(b"\x05\x00\x00\x00")
    one = transforms[5:]
    return [
        scan[:lie] + b"\x00\xca\x9a\x3b" + scan[lie + 4 :],
        echoes[:-24] + b"\x00\xca\x9a\x3b" * 6,
        b"\x02" + (2_000).to_bytes(4, "little") + one * 2_000,
        b"\x03" + (2_000).to_bytes(4, "little") + one * 2_000,
        b"\x02" + (10**9).to_bytes(4, "little") + one,
    ]


def read_input(data: bytes) -> None:
    """Read a bag with the input as one message among valid ones."""
    part = PARTS[data[0] % len(PARTS)] if data else PARTS[0]
    path = folder() / "messages.bag"
    path.unlink(missing_ok=True)
    written(path, part, data[1:])
    check_call(lambda: frames_of(path), len(data), path.name)
