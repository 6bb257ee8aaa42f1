"""The reader of measured distances."""

from __future__ import annotations

from bounds import check_file_reader

from evalkit_datasets.parsing.truth_files import read_spans


def seeds() -> list[bytes]:
    """Return distances with every type of end."""
    return [
        b'[[span]]\nname = "door"\nfrom = 1.5\nto = { at = "976052857.337284001", point = [0.1, 0] }\nmetres = 2.5\n',
        b"[[span]]\nfrom = { wall = [1.0, 2.0] }\nto = 3\nmetres = 4\nsigma_m = 0.02\n",
    ]


def swollen() -> list[bytes]:
    """Return long numbers and texts."""
    one = b"[[span]]\nfrom = 1\nto = 2\nmetres = "
    return [
        one + b"1e" + b"9" * 100,
        one + b"1e999999999999999999",
        one + b"1e-999999999999999999",
        one + b"9" * 4_000,
        one + b"1." + b"9" * 500_000,
        one + b'"' + b"x" * 1_000_000 + b'"',
        one + b"1\n" + b"x" * 100_000 + b" = 1\n",
        one.replace(b"from = 1", b"from = [" + b"1," * 200_000 + b"]") + b"1\n",
        b"span = " + b"[" * 5_000,
        one + b"1\n" + b"[" + b"a." * 20_000 + b"a]\n",
    ]


def read_input(data: bytes) -> None:
    """Read measured distances."""
    check_file_reader(read_spans, data, "fuzz.toml")
