"""The image of a map_server map, PGM or PNG, with valid settings."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from bounds import check_file_reader, folder
from PIL import Image

from evalkit.io import map_server

SETTINGS = "image: fuzz.image\nresolution: 0.05\norigin: [0, 0, 0]\n"


def seeds() -> list[bytes]:
    """Return images of every supported format."""
    made = [
        b"P5\n3 2\n255\n\x00\xcd\xfe\xfe\x00\x01",
        b"P2 # made\n2 2\n255\n0 205 254 254\n",
        b"P5 1 1 65535 \x01\x02",
    ]
    grey = np.array([[0, 205], [254, 254]], dtype=np.uint8)
    for image in (Image.fromarray(grey), Image.fromarray(np.stack([grey] * 3, axis=2)), Image.new("I;16", (2, 2))):
        content = BytesIO()
        image.save(content, "PNG")
        made.append(content.getvalue())
    return made


def swollen() -> list[bytes]:
    """Return headers with too large sizes, long comments, and a small file of many white pixels."""
    content = BytesIO()
    Image.new("1", (13_000, 13_000)).save(content, "PNG")
    return [
        b"P5\n1000000000 1000000000\n255\n\x00",
        b"P5\n" + b"9" * 100_000 + b" 1\n255\n\x00",
        b"P5" + b" " * 100_000,
        b"P5" + b"#\n" * 50_000,
        b"P5" + b" #\n" * 50_000,
        b"P5 1 1 255" + b"#" * 100_000,
        b"P2\n1 1\n255\n" + b"#" * 100_000,
        b"P2\n300 300\n255\n" + b"254 " * 90_000,
        b"P2\n1 1\n255\n" + b"9" * 100_000,
        content.getvalue(),
    ]


def read_input(data: bytes) -> None:
    """Read a map with the input as its image."""
    map_server.MAX_PIXELS = 2**20  # the memory of a valid image of that size is not a finding
    settings = folder() / "image.yaml"
    settings.write_text(SETTINGS, encoding="utf-8")
    check_file_reader(lambda _path: map_server.read_map(settings), data, "fuzz.image")
