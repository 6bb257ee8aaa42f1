"""Files are replaced whole, and nothing outside the given folder is written or removed."""

import errno
import os
import stat

import pytest

from evalkit.core.errors import StoreError
from evalkit.io import output_files


def test_a_file_is_created_with_its_folders_and_replaced(tmp_path):
    path = tmp_path / "a" / "b" / "name.txt"
    output_files.write_text(path, "one", tmp_path)
    output_files.write_text(path, "two", tmp_path)
    assert path.read_text() == "two"
    assert [file.name for file in path.parent.iterdir()] == ["name.txt"]


def test_a_write_that_fails_leaves_the_old_file_and_no_part(tmp_path, monkeypatch):
    path = tmp_path / "name.txt"
    output_files.write_text(path, "old")
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(errno.ENOSPC, "No space left on device")))
    with pytest.raises(StoreError, match=r"name.txt: cannot be written \(No space left on device\); free some space"):
        output_files.write_text(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_links_are_replaced_and_never_followed(tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    victim = outside / "victim.txt"
    victim.write_text("mine")
    root = tmp_path / "root"
    root.mkdir()
    (root / "name.txt").symlink_to(victim)
    (root / "name.txt.part").symlink_to(victim)  # a name that could be guessed
    output_files.write_text(root / "name.txt", "new", root)
    assert (root / "name.txt").read_text() == "new"
    assert not (root / "name.txt").is_symlink()
    (root / "runs").symlink_to(outside)
    for write in (
        lambda: output_files.write_text(root / "runs" / "key" / "victim.txt", "new", root),
        lambda: output_files.create_folder(root / "runs" / "key", root),
    ):
        with pytest.raises(StoreError, match="'runs' is a link or a file, not a folder"):
            write()
    with pytest.raises(StoreError, match="leads out of its folder"):
        output_files.write_text(root / ".." / "outside" / "victim.txt", "new", root)
    assert [file.name for file in outside.iterdir()] == ["victim.txt"]
    assert victim.read_text() == "mine"


def test_a_file_that_the_user_named_replaces_no_link_no_pipe_and_no_folder(tmp_path):
    plain, link, pipe, folder = (tmp_path / name for name in ("plain", "link", "pipe", "folder"))
    output_files.write_named_file(tmp_path / "new" / "name.txt", "new")
    assert (tmp_path / "new" / "name.txt").read_text() == "new"
    plain.write_text("old")
    link.symlink_to(plain)
    os.mkfifo(pipe)
    folder.mkdir()
    for path in (link, pipe, folder, tmp_path / "plain" / "below"):
        with pytest.raises(StoreError, match=f"{path.name}: (is a link, a device, a pipe or|cannot be written)"):
            output_files.write_named_file(path, "new")
    assert plain.read_text() == "old"
    assert link.is_symlink()
    assert pipe.is_fifo()
    output_files.write_named_file(plain, b"new")
    assert plain.read_text() == "new"


def test_the_content_is_on_disk_before_it_gets_its_name_and_the_folder_after(tmp_path, monkeypatch):
    order, replace = [], os.replace
    monkeypatch.setattr(os, "fsync", lambda file: order.append(stat.S_ISDIR(os.fstat(file).st_mode)))
    monkeypatch.setattr(os, "replace", lambda *names, **folders: (order.append("replace"), replace(*names, **folders)))
    output_files.write_text(tmp_path / "name.txt", "new")
    assert order == [False, "replace", True]
