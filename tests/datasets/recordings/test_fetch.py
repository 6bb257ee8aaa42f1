"""Downloads from a server in the same process."""

import hashlib
import http.server
import re
import socket
import threading
from dataclasses import replace
from types import MappingProxyType

import pytest

from evalkit.core.errors import BadData, DataMissing
from evalkit_datasets.recordings import catalog
from evalkit_datasets.recordings import fetch as fetching
from evalkit_datasets.recordings.building import builders
from evalkit_datasets.recordings.catalog import CatalogFile
from evalkit_datasets.recordings.fetch import fetch, why_offline

CONTENT = bytes(range(256)) * 2000


class Server(http.server.BaseHTTPRequestHandler):
    """HTTP server of CONTENT: /file with ranges, /norange without, /break stops half way, /lie sends other content."""

    def do_GET(self):
        asked = self.headers.get("Range")
        self.server.asked.append(asked)
        begin = int(asked.removeprefix("bytes=").removesuffix("-")) if asked and self.path != "/norange" else 0
        if self.path == "/absent" or begin >= len(CONTENT):
            self.send_error(404 if self.path == "/absent" else 416)
            return
        body = (b"x" * len(CONTENT) if self.path == "/lie" else CONTENT)[begin:]
        body = body * 5 if self.path == "/endless" else body
        self.send_response(206 if begin else 200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body[: len(body) // 2] if self.path == "/break" else body)

    def log_message(self, *_):
        """Print nothing."""


@pytest.fixture
def server():
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Server) as running:
        running.asked = []
        thread = threading.Thread(target=running.serve_forever, args=(0.01,))
        thread.start()
        yield running
        running.shutdown()
        thread.join()


@pytest.fixture
def register_file(server, tmp_path, monkeypatch):
    """Add one file under the given server path to the catalogue; returns its place in the cache."""
    monkeypatch.delenv(catalog.VARIABLE, raising=False)
    for proxy in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(proxy, raising=False)
    monkeypatch.setattr(catalog, "cache_folder", lambda: tmp_path / "cache")

    def add_to_catalog(path="/file", **changes):
        url = f"http://127.0.0.1:{server.server_port}{path}" if path else ""
        card = CatalogFile(
            "a.log", "set/a.log", "", "", "", hashlib.sha256(CONTENT).hexdigest(), bytes=len(CONTENT), url=url
        )
        monkeypatch.setattr(catalog, "load_catalog", lambda: MappingProxyType({"a.log": replace(card, **changes)}))
        return tmp_path / "cache" / "set" / "a.log"

    return add_to_catalog


def find_part_file(target, content):
    target.parent.mkdir(parents=True)
    part = target.with_name("a.log.part")
    part.write_bytes(content)
    return part


def test_a_file_is_downloaded_verified_and_then_found(register_file, server):
    target = register_file()
    heard = []
    assert fetch("a.log", lambda so_far, in_all: heard.append((so_far, in_all))) == target
    assert target.read_bytes() == CONTENT
    assert heard[-1] == (len(CONTENT), len(CONTENT))
    assert not target.with_name("a.log.part").exists()
    assert fetch("a.log") == target
    assert server.asked == [None]


def test_a_cache_that_cannot_be_created_is_named_with_the_variable_that_moves_it(register_file, server):
    target = register_file()
    target.parents[1].write_text("a file where the folder should be")
    what = f"a.log: cannot be kept in {target.parent} (Not a directory); set XDG_CACHE_HOME to a folder that can be"
    with pytest.raises(DataMissing, match=re.escape(what)):
        fetch("a.log")
    assert server.asked == []


def test_an_interrupted_download_is_kept_and_resumed(register_file, server):
    target = register_file("/break")
    with pytest.raises(DataMissing, match=r"could not be downloaded .* bytes are kept"):
        fetch("a.log")
    assert not target.exists()
    kept = target.with_name("a.log.part").stat().st_size
    assert 0 < kept <= len(CONTENT) // 2
    register_file("/file")
    assert fetch("a.log").read_bytes() == CONTENT
    assert server.asked == [None, f"bytes={kept}-"]


def test_a_server_without_ranges_sends_the_whole_file_again(register_file, server):
    target = register_file("/norange")
    find_part_file(target, CONTENT[:1000])
    assert fetch("a.log").read_bytes() == CONTENT
    assert server.asked == ["bytes=1000-"]


@pytest.mark.parametrize("size", [0, len(CONTENT)])
def test_a_complete_part_file_is_used(register_file, server, size):
    find_part_file(register_file(bytes=size), CONTENT)
    assert fetch("a.log").read_bytes() == CONTENT
    assert server.asked == ([] if size else [f"bytes={len(CONTENT)}-"])


@pytest.mark.parametrize("path", ["/lie", "/file"])
def test_a_wrong_file_is_deleted_and_reported(register_file, path):
    target = register_file(path)
    if path == "/file":
        find_part_file(target, b"y" * 1000)  # the beginning of another file
    with pytest.raises(BadData, match=r"not the catalogued file .* and was deleted; fetch it again"):
        fetch("a.log")
    assert not target.exists()
    assert not target.with_name("a.log.part").exists()


def test_a_git_blob_verifies_a_file_of_unknown_size(register_file):
    blob = hashlib.sha1(b"blob %d\0" % len(CONTENT) + CONTENT).hexdigest()
    register_file(sha256="", git_blob=blob, bytes=0)
    assert fetch("a.log").read_bytes() == CONTENT


def test_a_damaged_file_in_the_cache_is_downloaded_again(register_file):
    target = register_file()
    target.parent.mkdir(parents=True)
    target.write_bytes(b"rotten")
    assert fetch("a.log").read_bytes() == CONTENT


def test_a_damaged_file_in_the_users_folder_is_not_changed(register_file, tmp_path, monkeypatch):
    register_file()
    own = tmp_path / "own" / "set" / "a.log"
    own.parent.mkdir(parents=True)
    own.write_bytes(b"rotten")
    monkeypatch.setenv(catalog.VARIABLE, str(tmp_path / "own"))
    with pytest.raises(BadData, match="6 bytes instead of"):
        fetch("a.log")
    assert own.read_bytes() == b"rotten"


def test_a_missing_address_and_an_unreachable_server_are_reported(register_file):
    register_file("/absent")
    with pytest.raises(DataMissing, match=r"404.*check the connection"):
        fetch("a.log")
    register_file(url="http://127.0.0.1:9/file")
    with pytest.raises(DataMissing, match="could not be downloaded"):
        fetch("a.log")


def test_fetching_a_derived_file_fails_and_suggests_a_replacement(register_file):
    register_file("", derived="joined from b and c", instead=("b", "c"))
    with pytest.raises(DataMissing, match=r"no public URL \(joined from b and c\).*fetch a replacement: .* fetch b c"):
        fetch("a.log")


@pytest.mark.parametrize("size", [0, len(CONTENT)])
def test_a_server_that_sends_too_much_does_not_fill_the_disk(register_file, size, monkeypatch):
    monkeypatch.setattr("evalkit_datasets.recordings.fetch.MAX_BYTES", len(CONTENT))
    target = register_file("/endless", bytes=size)
    with pytest.raises(BadData, match=f"sends more than {len(CONTENT)} bytes; the download was deleted"):
        fetch("a.log")
    assert not list(target.parent.iterdir())


@pytest.mark.parametrize(
    "path", ["../a.log", "set/../../a.log", "/etc/a.log", "C:/a.log", "set\\..\\a.log", "a/./b", ".."]
)
def test_the_path_of_a_catalogued_file_is_relative_to_the_data_folder(path):
    with pytest.raises(ValueError, match="path: expected a path relative to the data folder"):
        CatalogFile("a.log", path, "", "", "")
    assert {entry.path for entry in catalog.load_catalog().values()}


def test_a_server_that_answers_is_online_whatever_it_answers(register_file, server, monkeypatch):
    monkeypatch.setattr(fetching, "ANSWER_S", 300.0)
    register_file()
    assert why_offline(f"http://127.0.0.1:{server.server_port}/file") == ""


def test_a_server_that_does_not_answer_is_not_waited_for(register_file, monkeypatch):
    register_file()
    monkeypatch.setattr(fetching, "ANSWER_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        assert why_offline(f"http://127.0.0.1:{silent.getsockname()[1]}/") == "no answer from 127.0.0.1 within 0.2 s"
    monkeypatch.setenv("EVALKIT_OFFLINE", "1")
    assert why_offline("http://127.0.0.1/") == "offline (EVALKIT_OFFLINE is set)"
    with pytest.raises(DataMissing, match="not on this machine, and EVALKIT_OFFLINE is set; unset"):
        fetch("a.log")


@pytest.mark.parametrize(
    ("blocks", "changes", "message"),
    [
        ([CONTENT], {}, ""),
        ([CONTENT[:-1], b"x"], {}, r"a\.log: the file built from b\.log differs from the catalogued one \("),
        (
            [CONTENT, b"x"],
            {},
            f"built from b.log differs from the catalogued one .more than {len(CONTENT)} bytes",
        ),
    ],
)
def test_a_built_file_is_the_catalogued_one_or_none(register_file, monkeypatch, blocks, changes, message):
    target = register_file("", build="made", sources=("b.log",), **changes)
    source = target.with_name("b.log")
    monkeypatch.setattr(builders, "iter_built", lambda build, sources: iter(blocks if sources == [source] else ()))
    own = fetching.fetch
    monkeypatch.setattr(fetching, "fetch", lambda name, progress: source)
    if message:
        with pytest.raises(BadData, match=message):
            own("a.log")
        assert not list(target.parent.iterdir())
    else:
        assert own("a.log").read_bytes() == CONTENT


def test_an_error_in_a_source_is_told_as_it_is(register_file, monkeypatch):
    def damaged(_build, _sources):
        raise BadData("b.log", "line 3", "not a number", "fetch it again")
        yield b""

    register_file("", build="made", sources=("b.log",))
    own = fetching.fetch
    monkeypatch.setattr(builders, "iter_built", damaged)
    monkeypatch.setattr(fetching, "fetch", lambda name, progress: name)
    with pytest.raises(BadData, match=r"b\.log.*line 3.*not a number"):
        own("a.log")
