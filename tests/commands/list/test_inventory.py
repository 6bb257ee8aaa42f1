"""The inventory: one broken plug-in is an entry with a reason and hides no other."""

import pytest

from evalkit.commands.list import inventory
from evalkit.plugins import registry

pytestmark = pytest.mark.usefixtures("strangers")


def rows(kind):
    return {entry.name: entry for entry in inventory.find_entries(kind)}


def test_every_registered_name_has_a_row():
    for kind in ("backends", "mappers", "datasets"):
        assert list(rows(kind)) == registry.names(kind)


def test_a_missing_library_is_listed_with_its_install_command():
    assert rows("backends")["absent"].missing == "the library 'nowhere' is not installed; pip install nowhere"
    assert rows("backends")["faulty"].missing == rows("backends")["paper"].missing == ""


def test_a_plugin_that_does_not_load_is_an_entry_with_the_reason():
    assert rows("backends")["unloadable"].missing == (
        "unloadable: its plug-in evalkit_faults_broken:SPEC does not load (the licence server does not answer); "
        "correct its entry point, install what it imports, or remove its package"
    )


def test_a_plugin_whose_check_of_its_needs_fails_is_an_entry_with_the_reason(monkeypatch):
    def broken(name):
        raise OSError("no such device")

    monkeypatch.setattr(registry, "mapper", broken)
    assert rows("mappers")["log-odds"].missing == "its plug-in failed: OSError: no such device"


def test_parameters_of_a_registration_include_the_front_end_and_those_of_an_odometry_do_not():
    assert {"prior", "keyframes", "deskew"} <= rows("backends")["paper"].parameters.keys()
    faulty = rows("backends")["faulty"].parameters
    assert {name: one["default"] for name, one in faulty.items()} == {"fault": "none", "at": 8}
    limit = rows("backends")["paper"].parameters["max_correspondence_m"]
    assert (limit["default"], limit["unit"], limit["low"], limit["high"]) == (0.3, "m", 0.0, None)
    assert rows("backends")["paper"].parameters["prior"]["choices"]


def test_a_reader_without_a_file_is_available():
    assert rows("datasets")["carmen"].missing == rows("datasets")["straight"].missing == ""
