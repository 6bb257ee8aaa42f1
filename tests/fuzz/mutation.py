"""Mutate valid inputs: used in the tests, and for fuzzing without atheris."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

WORDS = (
    b"nan", b"-nan", b"inf", b"-inf", b"1e999", b"-1", b"0", b"1000000000", b"9223372036854775808", b"0x1p9", b"1_0",
    b"\x00", b"\x00" * 8, b"\xff" * 4, b"\x7f\xff\xff\xff", b"\x00\x00\xc0\x7f", b"\x1b[2J",
    b"\xe2\x80\xa8", b"\xef\xbb\xbf",
    b"\r", b"\n", b"\n\n", b" ", b"\t", b"[", b"]", b"{", b"}", b'"', b"'", b"#", b":", b",", b"=", b"[[", b"&a", b"*a",
    b"\xd9\xa3", b"9" * 5000, b"x" * 5000, b"[" * 3000,
)  # fmt: skip
"""Values that often break readers of numbers, texts and lengths."""


def mutants(seeds: Sequence[bytes], count: int, seed: int) -> Iterator[bytes]:
    """Yield ``count`` mutated inputs, the same for the same ``seed``."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        made = bytearray(seeds[rng.integers(len(seeds))])
        for _ in range(rng.integers(1, 6)):
            _DAMAGE[rng.integers(len(_DAMAGE))](made, seeds, rng)
        yield bytes(made)


def _flip(made: bytearray, _seeds: Sequence[bytes], rng: np.random.Generator) -> None:
    if made:
        made[rng.integers(len(made))] ^= 1 << int(rng.integers(8))


def _byte(made: bytearray, _seeds: Sequence[bytes], rng: np.random.Generator) -> None:
    if made:
        made[rng.integers(len(made))] = int(rng.integers(256))


def _cut(made: bytearray, _seeds: Sequence[bytes], rng: np.random.Generator) -> None:
    del made[int(rng.integers(len(made) + 1)) :]


def _drop(made: bytearray, _seeds: Sequence[bytes], rng: np.random.Generator) -> None:
    begin = int(rng.integers(len(made) + 1))
    del made[begin : begin + int(rng.integers(1, 64))]


def _double(made: bytearray, _seeds: Sequence[bytes], rng: np.random.Generator) -> None:
    begin = int(rng.integers(len(made) + 1))
    made[begin:begin] = made[begin : begin + int(rng.integers(1, 200))]


def _word(made: bytearray, _seeds: Sequence[bytes], rng: np.random.Generator) -> None:
    begin, word = int(rng.integers(len(made) + 1)), WORDS[rng.integers(len(WORDS))]
    made[begin : begin + int(rng.integers(2)) * len(word)] = word


def _splice(made: bytearray, seeds: Sequence[bytes], rng: np.random.Generator) -> None:
    other = seeds[rng.integers(len(seeds))]
    begin = int(rng.integers(len(other) + 1))
    at = int(rng.integers(len(made) + 1))
    made[at:at] = other[begin : begin + int(rng.integers(1, 400))]


def _number(made: bytearray, _seeds: Sequence[bytes], rng: np.random.Generator) -> None:
    """Overwrite 4 or 8 bytes with a little-endian integer, as used for lengths."""
    size = int(rng.choice([4, 8]))
    value = int(rng.choice([0, 1, 255, 10**6, 10**9, 2**31 - 1, 2**32 - 1]))
    begin = int(rng.integers(len(made) + 1))
    made[begin : begin + size] = value.to_bytes(size, "little")


_DAMAGE = (_flip, _byte, _cut, _drop, _double, _word, _splice, _number)
