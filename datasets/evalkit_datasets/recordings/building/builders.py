"""The builders of catalogued files, by the name that the catalogue gives: each yields the text of a file."""

from __future__ import annotations

import tarfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from evalkit.core.errors import BadData
from evalkit_datasets.recordings.building import fr079, graph_poses, intel

BLOCK_BYTES = 2**16

Builder = Callable[..., Iterator[str]]

BUILDERS: Mapping[str, Builder] = {
    "fr079": fr079.build_log,
    "intel": intel.build_log,
    "intel exact": intel.build_exact_log,
    "graph poses": graph_poses.build_trajectory,
}


def iter_built(build: str, sources: list[Path]) -> Iterator[bytes]:
    """Yield the content of a built file: by the builder of that name, or the member of an archive at that path.

    Raises BadData, with the place, if a source is damaged.
    """
    if build in BUILDERS:
        yield from (text.encode("ascii") for text in BUILDERS[build](*sources))
    else:
        yield from _iter_member(sources[0], build)


def _iter_member(archive: Path, name: str) -> Iterator[bytes]:
    try:
        with tarfile.open(archive) as content:
            file = content.extractfile(name)
            if file is None:
                raise BadData(str(archive), name, "not a file of the archive", "fetch the archive again")
            while block := file.read(BLOCK_BYTES):
                yield block
    except (tarfile.TarError, KeyError, EOFError, OSError) as error:
        raise BadData(str(archive), name, f"cannot be unpacked ({error})", "fetch the archive again") from None
