"""The YAML file of a map_server map, with a valid image."""

from __future__ import annotations

from bounds import check_file_reader, folder

from evalkit.io import map_server


def seeds() -> list[bytes]:
    """Return settings as written by map_server and nav2."""
    return [
        b"image: fuzz.pgm\nresolution: 0.05\norigin: [-1.0, -2.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\n",
        b"image: fuzz.pgm\nmode: trinary\nresolution: 1e-2\norigin:\n- 0\n- 0\n- 0\nnegate: 1\n",
    ]


def swollen() -> list[bytes]:
    """Return aliases that double with every line, and deep nesting."""
    laughs = b"a0: &a0 [lol, lol]\n" + b"".join(
        b"a%d: &a%d [*a%d, *a%d]\n" % (k, k, k - 1, k - 1) for k in range(1, 40)
    )
    keys = b"resolution: 0.05\norigin: [0, 0, 0]\n"
    return [
        laughs + keys + b"image: *a39\n",
        laughs + keys + b"image: fuzz.pgm\nmode: *a39\n",
        laughs + b"image: fuzz.pgm\nresolution: *a39\norigin: *a39\n",
        laughs + b"image: fuzz.pgm\nresolution: 1\norigin: [*a39, 0, 0]\n",
        keys + b"image: fuzz.pgm\nmode: " + b"x" * 1_000_000 + b"\n",
        b"image: " + b"[" * 5_000,
        b"a: " * 2_000,
        b"- " * 50_000,
        keys + b"image: /etc/passwd\n",
        keys + b"image: !!python/object/apply:os.system [true]\n",
        keys + b'image: "\\0"\n',
        keys + b"image: " + b"x" * 5_000 + b"\n",
        b"? " * 5_000,
    ]


def read_input(data: bytes) -> None:
    """Read a map with the input as its settings."""
    (folder() / "fuzz.pgm").write_bytes(b"P5\n2 2\n255\n\x00\xcd\xfe\xfe")
    check_file_reader(map_server.read_map, data, "fuzz.yaml", named="")  # it may name an image that does not exist
    map_server.find_map_image(folder() / "fuzz.yaml")
