"""The catalogue of recorded files."""

import gzip
import hashlib
import re
from dataclasses import fields, replace

import pytest

from evalkit.core.errors import BadData, DataMissing, UnknownName
from evalkit_datasets.recordings import catalog, data_sets
from evalkit_datasets.recordings.catalog import CatalogFile


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Use a data folder and a cache inside the temporary folder."""
    monkeypatch.setenv(catalog.VARIABLE, str(tmp_path / "data"))
    monkeypatch.setattr(catalog, "cache_folder", lambda: tmp_path / "cache")
    return tmp_path


def card(content=b"hello", **changes):
    known = {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content), **changes}
    return CatalogFile("a.log", "set/a.log", "a log", "MIT", "somebody", **known)


def put_file(folder, content):
    path = folder / "set" / "a.log"
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("name", list(catalog.load_catalog()))
def test_every_card_is_complete(name):
    entry = catalog.get_file(name)
    kinds = {field.name: field.type for field in fields(CatalogFile)}
    for field in fields(CatalogFile):
        expected = {"str": str, "int": int, "tuple[str, ...]": tuple}[kinds[field.name]]
        assert isinstance(getattr(entry, field.name), expected), field.name
    assert entry.summary
    assert entry.licence
    assert entry.citation
    assert bool(re.fullmatch("[0-9a-f]{64}", entry.sha256)) != bool(re.fullmatch("[0-9a-f]{40}", entry.git_blob))
    assert [bool(entry.url), bool(entry.derived), bool(entry.build)].count(True) == 1
    assert bool(entry.build) == bool(entry.sources)
    assert all(catalog.get_file(source).url and catalog.get_file(source).bytes for source in entry.sources)
    assert not entry.build or entry.bytes
    assert not entry.url or re.fullmatch(r"https://raw\.githubusercontent\.com/[^/]+/[^/]+/[0-9a-f]{40}/\S+", entry.url)
    assert all(catalog.get_file(other).url for other in entry.instead)
    assert ".." not in entry.path
    assert not entry.path.startswith("/")


def test_every_data_set_needs_only_files_of_the_catalogue():
    assert all(catalog.get_file(name) for names in data_sets.FILES.values() for name in names)


def test_an_unknown_file_lists_the_known_ones():
    with pytest.raises(UnknownName, match=r"did you mean 'fr079\.relations'"):
        catalog.get_file("fr079.relation")


def test_the_data_folder_is_searched_before_the_cache(folders):
    inside = put_file(folders / "data", b"hello")
    assert catalog.find_local(card()) == inside
    inside.unlink()
    assert catalog.find_local(card()) is None
    assert catalog.find_local(card()) is None
    assert catalog.find_local(card()) != put_file(folders / "cache", b"hello").with_name("other")
    assert catalog.find_local(card()) == folders / "cache" / "set" / "a.log"


def test_a_correct_file_passes_by_sha256_and_by_git_blob(tmp_path):
    path = put_file(tmp_path, b"hello")
    catalog.verify(card(), path)
    # `printf hello | git hash-object --stdin`
    catalog.verify(card(sha256="", git_blob="b6fc4c620b67d95f953a5c1c1230aaab5db5a1b0"), path)


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"bytes": 6}, "5 bytes instead of 6"),
        ({"sha256": "0" * 64}, r"sha256 2cf24dba5fb0\.\.\. instead of 000000000000"),
        ({"sha256": "", "git_blob": "0" * 40}, r"git blob b6fc4c620b67\.\.\. instead of 000000000000"),
    ],
)
def test_a_wrong_file_is_reported_with_a_remedy(tmp_path, changes, part):
    with pytest.raises(BadData, match=rf"a\.log: {part}.*replace it with the catalogued file"):
        catalog.verify(card(**changes), put_file(tmp_path, b"hello"))
    with pytest.raises(BadData, match=r"fetch it again: .* fetch a\.log"):
        catalog.verify(card(**changes, url="https://x"), tmp_path / "set" / "a.log")


def test_a_missing_file_is_reported_with_the_searched_places_and_a_remedy(folders):
    with pytest.raises(
        DataMissing, match=r"EVALKIT_DATA=.*data or in the cache .*cache; fetch it: .* fr079\.relations"
    ):
        catalog.locate("fr079.relations")


def test_the_error_of_a_derived_file_gives_the_reason_and_a_replacement(folders):
    with pytest.raises(DataMissing, match=r"no public URL \(the poses of .*replacement: .* intel-corrected\.log\.gz"):
        catalog.locate("intel-gmapping.tum")
    assert data_sets.STATIC.missing().endswith("fetch it: evalkit datasets fetch static")
    assert data_sets.FR079.missing().endswith("fetch it: evalkit datasets fetch fr079")


def test_a_compressed_copy_is_found_and_verified_by_its_plain_content(folders):
    path = put_file(folders / "data", b"")
    packed = path.with_name("a.log.gz")
    path.rename(packed)
    packed.write_bytes(gzip.compress(b"hello"))
    assert catalog.find_local(card()) == packed
    catalog.verify(card(), packed)
    packed.write_bytes(gzip.compress(bytes(10_000_000)))  # only as much is unpacked as tells that it is another file
    with pytest.raises(BadData, match="bytes instead of 5"):
        catalog.verify(card(), packed)


def test_a_raw_log_is_used_where_somebody_has_it(folders, monkeypatch):
    assert data_sets.needed_files("fr079")[0] == "fr079-built.clf"
    truth = ("intel.relations", "intel-reference-flirtlib.tum")
    assert data_sets.needed_files("intel") == ("intel-built.clf", *truth)
    assert data_sets.needed_files("intel", "exact") == ("intel-exact.clf", *truth)
    assert data_sets.files_of("intel") == ("intel-built.clf", *truth, "intel-exact.clf")
    content = "".join(f"FLASER 180 {'1.0 ' * 180}{x} 0 0 {x} 0 0 {x}.5 h 0\n" for x in range(3)).encode()
    raw = folders / "data" / "fr079" / "fr079.clf"
    raw.parent.mkdir(parents=True)
    raw.write_bytes(content)
    real = catalog.get_file
    blob = hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()
    monkeypatch.setattr(
        catalog, "get_file", lambda name: replace(real(name), git_blob=blob) if name == "fr079.clf" else real(name)
    )
    assert data_sets.needed_files("fr079")[0] == "fr079.clf"
    assert data_sets.FR079.missing().startswith("fr079.relations (and 1 more)")
    for name, text in (
        ("fr079.relations", "0.5 2.5 2 0 0 0 0 0\n"),
        ("fr079-reference-flirtlib.tum", "0.5 0 0 0 0 0 0 1\n"),
    ):
        (raw.parent / name).write_text(text)
    monkeypatch.setattr(catalog, "verify", lambda *_: None)
    sequence = data_sets.FR079.make()
    assert [frame.odom_from_base.x for frame in sequence.frames()] == [0.0, 1.0, 2.0]
    assert any("raw log" in name for name in sequence.notes())


def test_a_data_set_is_complete_or_lists_its_missing_files(folders):
    lacking = catalog.describe_missing("turtlebot4", data_sets.FILES["turtlebot4"])
    assert lacking.startswith("macfirst_floor_take_2_0.db3 (and 1 more): not found")
    for name in data_sets.FILES["turtlebot4"]:
        path = folders / "data" / catalog.get_file(name).path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    assert catalog.describe_missing("turtlebot4", data_sets.FILES["turtlebot4"]) == ""
