"""The reader of pose graphs in g2o and TORO format."""

from __future__ import annotations

from bounds import check_file_reader

from evalkit.io.g2o import format_g2o, read_g2o


def seeds() -> list[bytes]:
    """Return a graph in each spelling, with a fixed pose, a comment, and poses that only edges give."""
    return [
        b"VERTEX_SE2 7 0 0 0\nVERTEX_SE2 9 1 0 0.5\nFIX 7\nEDGE_SE2 7 9 1 0 0.5 1 0 0 1 0 1\n",
        b"# TORO\nVERTEX2 0 0 0 0\nEDGE2 0 1 1 0 0.5 2 0 3 4 0 0\nEDGE2 2 1 1 0 0.5 2 0 3 4 0 0\n",
    ]


def swollen() -> list[bytes]:
    """Return large numbers of poses, long numbers, and many lines."""
    return [
        b"VERTEX_SE2 4611686018427387903 0 0 0\n",
        b"VERTEX_SE2 " + b"9" * 200_000 + b" 0 0 0\n",
        b"EDGE_SE2 0 1 1e" + b"9" * 1000 + b" 0 0 1 0 0 1 0 1\n",
        b"".join(b"EDGE_SE2 %d %d 1 0 0 1 0 0 1 0 1\n" % (i, i + 1) for i in range(5_000)),
    ]


def read_input(data: bytes) -> None:
    """Read a graph and write it again."""

    def read(path):  # type: ignore[no-untyped-def]
        file = read_g2o(path)
        format_g2o(file.graph, file.ids, file.fixed.tolist())

    check_file_reader(read, data, "fuzz.g2o")
