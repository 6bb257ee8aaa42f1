"""Files in a results folder: what was saved comes back, what somebody made up is refused without being accepted."""

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
def test_arrays_come_back_as_they_were(tmp_path, save):
    save(tmp_path / "a.npz", **ARRAYS)
    found = untrusted_io.arrays(tmp_path / "a.npz")
    assert found.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype


def test_an_array_comes_back_as_it_was(tmp_path):
    np.save(tmp_path / "a.npy", ARRAYS["columns"])
    np.testing.assert_array_equal(untrusted_io.array(tmp_path / "a.npy"), ARRAYS["columns"])


def npy(header, body=b""):
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + body


HUGE = npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }")
OBJECTS = npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", b"\x80\x04N.")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (HUGE, r"0 bytes for an array \(1000000000000,\) of float64"),
        (OBJECTS, "no array of numbers or texts"),
        (npy("{'descr': __import__('os'), 'fortran_order': False, 'shape': (), }"), "no array of numbers or texts"),
        (npy("{" * 5000), "no array of numbers or texts"),
        (npy("{'descr': '<f7', 'fortran_order': False, 'shape': (1,), }", b"\0" * 7), "no kind of array"),
        (npy("{'descr': '<U0', 'fortran_order': False, 'shape': (1,), }"), "0 bytes for an array"),
        (b"", "no array"),
    ],
)
def test_a_header_is_neither_evaluated_nor_accepted(tmp_path, content, told):
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(ValueError, match=told):
        untrusted_io.array(tmp_path / "a.npy")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", content)
    with pytest.raises(ValueError, match=told):
        untrusted_io.arrays(tmp_path / "a.npz")


def test_an_archive_that_would_fill_the_memory_is_not_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(untrusted_io, "MAX_BYTES", 1000)
    np.savez_compressed(tmp_path / "a.npz", zeros=np.zeros(1000))
    with pytest.raises(ValueError, match="holds more than 1000 bytes"):
        untrusted_io.arrays(tmp_path / "a.npz")


@pytest.mark.parametrize("way", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_an_archive_packed_as_numpy_packs_none_is_refused(tmp_path, way):
    body = io.BytesIO()
    np.save(body, np.zeros(3))
    with zipfile.ZipFile(tmp_path / "a.npz", "w", way) as archive:
        archive.writestr("a.npy", body.getvalue())
    with pytest.raises(ValueError, match="packed in way"):
        untrusted_io.arrays(tmp_path / "a.npz")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"words", b"PK\x05\x06" + b"\xff" * 18])
def test_what_is_no_archive_is_told_as_such(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(ValueError, match="damaged archive"):
        untrusted_io.arrays(tmp_path / "a.npz")


def test_json_that_nests_without_end_is_no_json():
    assert untrusted_io.values(b'{"a": [1]}') == {"a": [1]}
    with pytest.raises(ValueError, match="nested too deeply"):
        untrusted_io.values("[" * 100_000)
