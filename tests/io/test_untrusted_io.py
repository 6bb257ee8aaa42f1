"""Arrays and JSON of a results folder: saved values are read back, crafted files are rejected."""

import io
import zipfile

import numpy as np
import pytest

from evalkit.io import untrusted_io

ARRAYS = {
    "numbers": np.arange(6.0).reshape(2, 3),
    "columns": np.asfortranarray(np.arange(6.0, dtype=np.float32).reshape(2, 3)),
    "nothing": np.zeros((0, 3)),
    "one": np.array(3, dtype=np.int64),
    "text": np.array("words: \u00e9"),
    "marks": np.array([True, False]),
}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_saved_arrays_are_read_back_unchanged(tmp_path, save):
    save(tmp_path / "a.npz", **ARRAYS)
    found = untrusted_io.read_arrays(tmp_path / "a.npz")
    assert found.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype


def test_a_saved_array_is_read_back_unchanged(tmp_path):
    np.save(tmp_path / "a.npy", ARRAYS["columns"])
    np.testing.assert_array_equal(
        untrusted_io.parse_array(untrusted_io.read_bytes(tmp_path / "a.npy")), ARRAYS["columns"]
    )


def npy(header, body=b""):
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + body


HUGE = npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }")
OBJECTS = npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", b"\x80\x04N.")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (HUGE, r"0 bytes for an array \(1000000000000,\) of float64"),
        (OBJECTS, "not an array of numbers or strings"),
        (
            npy("{'descr': __import__('os'), 'fortran_order': False, 'shape': (), }"),
            "not an array of numbers or strings",
        ),
        (npy("{" * 5000), "not an array of numbers or strings"),
        (npy("{'descr': '<f7', 'fortran_order': False, 'shape': (1,), }", b"\0" * 7), "not a data type"),
        (npy("{'descr': '<U0', 'fortran_order': False, 'shape': (1,), }"), "0 bytes for an array"),
        (b"", "not an array"),
    ],
)
def test_an_invalid_header_is_rejected_and_never_evaluated(tmp_path, content, message):
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(ValueError, match=message):
        untrusted_io.parse_array(untrusted_io.read_bytes(tmp_path / "a.npy"))
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", content)
    with pytest.raises(ValueError, match=message):
        untrusted_io.read_arrays(tmp_path / "a.npz")


def test_an_archive_that_would_fill_the_memory_is_rejected(tmp_path, monkeypatch):
    monkeypatch.setattr(untrusted_io, "MAX_BYTES", 1000)
    np.savez_compressed(tmp_path / "a.npz", zeros=np.zeros(1000))
    with pytest.raises(ValueError, match="holds more than 1000 bytes"):
        untrusted_io.read_arrays(tmp_path / "a.npz")


@pytest.mark.parametrize("way", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_compression_method_that_numpy_does_not_use_is_rejected(tmp_path, way):
    body = io.BytesIO()
    np.save(body, np.zeros(3))
    with zipfile.ZipFile(tmp_path / "a.npz", "w", way) as archive:
        archive.writestr("a.npy", body.getvalue())
    with pytest.raises(ValueError, match="compression method"):
        untrusted_io.read_arrays(tmp_path / "a.npz")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"words", b"PK\x05\x06" + b"\xff" * 18])
def test_a_file_that_is_not_an_archive_is_rejected(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(ValueError, match="damaged archive"):
        untrusted_io.read_arrays(tmp_path / "a.npz")


def test_json_that_nests_too_deeply_is_rejected():
    assert untrusted_io.parse_json(b'{"a": [1]}') == {"a": [1]}
    with pytest.raises(ValueError, match="nested too deeply"):
        untrusted_io.parse_json("[" * 100_000)


@pytest.mark.parametrize("half", [r"\ud800", r"\uDFFF", r"\udc00\ud800"])
def test_half_a_character_which_no_file_can_hold_is_refused(half):
    with pytest.raises(ValueError, match="surrogates not allowed"):
        untrusted_io.parse_json(f'["{half}"]'.encode())
    assert untrusted_io.parse_json(r'["\ud83d\ude00"]') == ["\U0001f600"]
