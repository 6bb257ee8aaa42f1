"""Lines of plain and compressed text, read in bounded memory."""

import gzip
import random
import tracemalloc
import zlib
from itertools import pairwise

import pytest

from evalkit.core.errors import BadData
from evalkit.io import text_lines
from evalkit.io.input_files import BLOCK_BYTES, read_text
from evalkit.io.text_lines import MAX_LINE_BYTES, iter_lines


def write_text(folder, content):
    path = folder / "lines.txt"
    path.write_bytes(content)
    return path


def lines(folder, content):
    return list(iter_lines(write_text(folder, content), "text"))


TEXT = b"first\n\n" + random.Random(0).randbytes(3 * BLOCK_BYTES).replace(b"\n", b" ") + b"\nlast but one\r\nlast"


@pytest.mark.parametrize("end", [b"", b"\n"])
@pytest.mark.parametrize("cuts", [(), (3,), (BLOCK_BYTES, BLOCK_BYTES + 1)])
def test_lines_are_those_of_the_whole_text_however_it_is_compressed(tmp_path, end, cuts):
    content = TEXT + end
    edges = [0, *cuts, len(content)]
    packed = b"".join(gzip.compress(content[a:b]) for a, b in pairwise(edges))
    assert lines(tmp_path, content) == content.split(b"\n")
    assert lines(tmp_path, packed) == content.split(b"\n")


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_a_mark_of_utf_8_is_no_part_of_the_first_line(tmp_path, pack):
    assert lines(tmp_path, pack(b"\xef\xbb\xbf1.5,2\n1.6,3")) == [b"1.5,2", b"1.6,3"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\n<!DOCTYPE html>\n<title>404</title>", "a web page, not the file; fetch the file again, from the address"),
        (b"<HTML>", "a web page"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\n", "a pointer of Git LFS, not the file; fetch"),
        ("1.5 2\n".encode("utf-16"), "UTF-16 text; save it as UTF-8"),
    ],
)
def test_what_lies_in_place_of_a_file_is_named(tmp_path, content, said):
    path = write_text(tmp_path, content)
    for read in (lambda: list(iter_lines(path, "text")), lambda: read_text(path, "text")):
        with pytest.raises(BadData, match=rf"lines\.txt: {said}"):
            read()


@pytest.mark.parametrize("left", [0, 1])
def test_a_second_gzip_part_is_read_also_where_it_begins_at_the_end_of_a_block(tmp_path, left):
    """``left``: bytes of it in the block of the first part, whose length the name of a file in its header gives."""
    packed = gzip.compress(b"one\n")
    named = packed[:3] + b"\x08" + packed[4:10]  # the flag of a file name
    named += b"x" * (BLOCK_BYTES - len(packed) - 1 - left) + b"\0" + packed[10:]
    assert len(named) == BLOCK_BYTES - left
    assert lines(tmp_path, named + gzip.compress(b"two")) == [b"one", b"two"]


def test_bytes_after_the_gzip_content_are_ignored(tmp_path):
    assert lines(tmp_path, gzip.compress(b"one\ntwo") + b"\0" * 100) == [b"one", b"two"]


@pytest.mark.parametrize("left", [1, 5, BLOCK_BYTES])
def test_truncated_gzip_is_reported_wherever_it_ends(tmp_path, left):
    packed = gzip.compress(TEXT)
    with pytest.raises(BadData, match="cut short"):
        lines(tmp_path, packed[:-left])


def test_damaged_gzip_is_reported(tmp_path):
    packed = bytearray(gzip.compress(TEXT))
    packed[len(packed) // 2] ^= 0xFF
    with pytest.raises(BadData, match=r"damaged gzip|cut short"):
        lines(tmp_path, bytes(packed))


def test_an_endless_compressed_line_is_rejected_before_it_fills_the_memory(tmp_path):
    packer = zlib.compressobj(9, wbits=31)
    path = tmp_path / "bomb.gz"
    with path.open("wb") as file:
        for _ in range(100):
            file.write(packer.compress(b"0" * 2**20))
        file.write(packer.flush())
    tracemalloc.start()
    with pytest.raises(BadData, match="line 1: longer than 4 MiB"):
        list(iter_lines(path, "text"))
    assert tracemalloc.get_traced_memory()[1] < 4 * MAX_LINE_BYTES
    tracemalloc.stop()


def test_a_gzip_file_that_unpacks_to_a_thousand_times_its_size_is_rejected(tmp_path, monkeypatch):
    path = write_text(tmp_path, gzip.compress(b"0\n" * 2**20))  # 2 MiB in 2 kB
    assert sum(1 for _ in iter_lines(path, "text")) == 2**20 + 1
    monkeypatch.setattr(text_lines, "FREE_BYTES", 2**20)
    with pytest.raises(BadData, match="unpacks to more than 50 times its size and 1 MiB"):
        list(iter_lines(path, "text"))


def test_a_long_compressed_text_is_read_in_bounded_memory(tmp_path):
    path = write_text(tmp_path, gzip.compress(b"0123456789abcdef" * 64 + b"\n") * 10_000)
    tracemalloc.start()
    assert sum(len(line) for line in iter_lines(path, "text")) == 10_000 * 1024
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()
