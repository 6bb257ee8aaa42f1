"""Plug-in names from entry points, found without heavy imports."""

import os
import signal
import site
import subprocess
import sys
from importlib import metadata
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

import evalkit
from evalkit.core.errors import NotInstalled, UnknownName
from evalkit.plugins import defaults, registry
from evalkit.plugins.address import backend_at
from evalkit.plugins.specs import BackendSpec, DatasetSpec, MapperSpec, OdometrySpec

HEAVY = (
    "pandas",
    "matplotlib",
    "open3d",
    "kiss_icp",
    "rosbags",
    "scipy",
    "typer",
    "evalkit_baselines",
    "evalkit_datasets",
)


def loaded_by(statement):
    """Return the heavy modules that a new process has loaded after a statement."""
    code = f"import sys\n{statement}\nprint(*(name for name in {HEAVY} if name in sys.modules))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return answer.stdout.split()


@pytest.fixture
def points(monkeypatch):
    """Replace all entry points."""
    known = []
    monkeypatch.setattr(metadata, "entry_points", lambda: EntryPoints(known))
    registry._find_points.cache_clear()
    yield known
    registry._find_points.cache_clear()


@pytest.mark.parametrize("kind", ["backends", "mappers", "datasets", "metrics"])
def test_a_name_of_two_packages_is_neither_of_them(points, kind):
    ours, theirs = (EntryPoint("same", value, f"evalkit.{kind}") for value in ("ours:SPEC", "theirs:SPEC"))
    points += [ours, theirs]
    assert registry.names(kind) == ["same"]
    with pytest.raises(NotInstalled, match=r"^same: is registered by ours:SPEC and by theirs:SPEC; rename one"):
        registry.load(kind, "same", object)
    with pytest.raises(NotInstalled, match="registered by"):
        registry.find_address(kind, "same")


@pytest.mark.parametrize("group", ["evalkit.backend", "evalkit_backends", "evalkit.mappers"])
def test_a_name_in_another_group_is_named_with_that_group(points, group):
    points.append(EntryPoint("icp", "ours:SPEC", group))
    with pytest.raises(UnknownName, match=rf"'icp' \(ours:SPEC is registered as {group}, not as evalkit.backends\)"):
        registry.backend("icp")


def test_the_same_entry_point_in_two_packages_is_one(points):
    points += [EntryPoint("icp", "evalkit_baselines.paper:SPEC", "evalkit.backends") for _ in range(2)]
    assert registry.find_address("backends", "icp") == "evalkit_baselines.paper:SPEC"


def test_importing_evalkit_loads_no_heavy_module():
    assert loaded_by("import evalkit") == []


def test_listing_names_loads_no_plug_in():
    kinds = ("backends", "mappers", "datasets", "metrics", "commands")
    assert loaded_by(f"from evalkit.plugins import registry\nfor kind in {kinds}: registry.names(kind)") == []


def test_loading_a_name_loads_only_its_own_module():
    statement = "from evalkit.plugins import registry\nregistry.backend('open3d-icp')\nregistry.backend('kiss-icp')"
    assert not {"open3d", "kiss_icp", "evalkit_datasets"} & set(loaded_by(statement))


@pytest.mark.parametrize(
    ("kind", "load", "spec"),
    [
        ("backends", registry.backend, BackendSpec),
        ("mappers", registry.mapper, MapperSpec),
        ("datasets", registry.dataset, DatasetSpec),
    ],
)
def test_every_shipped_name_resolves_to_its_spec(kind, load, spec):
    names = registry.names(kind)
    assert names
    assert names == sorted(names)
    assert all(isinstance(load(name), spec) for name in names)


def test_a_back_end_is_loaded_from_its_address_without_a_search(points):
    address = "evalkit_baselines.wheel_odometry:SPEC"
    assert registry.backend("wheel-odometry", address).summary.startswith("wheel odometry")
    assert registry.find_address("backends", "wheel-odometry") == ""  # nothing is installed
    points.append(EntryPoint("wheel-odometry", f"{address} [extra]", "evalkit.backends"))
    registry._find_points.cache_clear()
    assert registry.find_address("backends", "wheel-odometry") == address
    with pytest.raises(NotInstalled, match=r"wheel_odometry:NOTHING does not load"):
        registry.backend("wheel-odometry", "evalkit_baselines.wheel_odometry:NOTHING")


def test_names_are_sorted_independent_of_package_order(points):
    points += [EntryPoint(name, "nowhere:SPEC", "evalkit.mappers") for name in ("b", "c", "a")]
    assert registry.names("mappers") == ["a", "b", "c"]


def test_an_unknown_name_lists_the_known_names_and_suggests_the_nearest():
    with pytest.raises(
        UnknownName, match=r"no backend named 'wheel-odometri' \(did you mean 'wheel-odometry'\?\)"
    ) as e:
        registry.backend("wheel-odometri")
    assert all(name in str(e.value) for name in registry.names("backends"))


@pytest.mark.parametrize(
    ("value", "parts"),
    [
        ("nowhere_to_be_found:SPEC", ["nowhere_to_be_found:SPEC does not load", "correct its entry point"]),
        ("math:SPEC", ["math:SPEC does not load", "SPEC"]),
        ("math:pi", ["math:pi is a float", "expected a BackendSpec"]),
    ],
)
def test_a_broken_plug_in_and_an_unknown_name_give_different_errors(points, value, parts):
    points.append(EntryPoint("broken", value, "evalkit.backends"))
    assert registry.names("backends") == ["broken"]
    with pytest.raises(NotInstalled) as caught:
        registry.backend("broken")
    assert str(caught.value).startswith("broken: ")
    assert all(part in str(caught.value) for part in parts)


def test_a_third_party_plug_in_is_found_like_the_shipped_ones(points, monkeypatch):
    spec = OdometrySpec(object, "a stranger", "none", "MIT")
    monkeypatch.setattr(evalkit, "STRANGER", spec, raising=False)
    points.append(EntryPoint("mine", "evalkit:STRANGER", "evalkit.backends"))
    assert registry.backend("mine") is spec


@pytest.mark.parametrize(
    ("module", "why"),
    [
        ("evalkit_faults_deadly", f"importing it ends the process by signal {int(signal.SIGSEGV)}"),
        ("evalkit_faults_stuck", "importing it takes more than 2 s"),
    ],
)
def test_a_plug_in_whose_import_crashes_or_hangs_is_reported_as_missing(strangers, points, monkeypatch, module, why):
    monkeypatch.setattr(registry, "LOADING_S", 2.0 if "stuck" in module else 300.0)
    registry._import_failure.cache_clear()
    points.append(EntryPoint("theirs", f"{module}:SPEC", "evalkit.backends"))
    assert registry.find_backend("theirs").missing() == (
        f"theirs: its plug-in {module}:SPEC does not load ({why}); repair or remove its package"
    )


def test_a_script_that_exits_on_import_does_not_end_evalkit(tmp_path, monkeypatch):
    (tmp_path / "my_script.py").write_text("import sys\nsys.exit(0)\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    found = registry.find_backend("my_script:SPEC").missing()
    assert "my_script:SPEC: its plug-in my_script:SPEC does not load (importing it calls sys.exit(0)); " in found


def test_the_trial_import_of_a_plug_in_ends_what_it_leaves_behind(tmp_path, monkeypatch, has_ended):
    left = tmp_path / "left"
    starts = "subprocess.Popen(['sleep', '900']).pid"
    (tmp_path / "leaves_a_process.py").write_text(
        f"import subprocess\nfrom pathlib import Path\nPath({str(left)!r}).write_text(str({starts}))\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(registry, "LOADING_S", 300.0)
    assert registry._import_failure("leaves_a_process") == ""
    assert has_ended(int(left.read_text()))


def test_a_back_end_under_development_is_found_by_its_module():
    assert registry.backend("evalkit_baselines.paper:TIGHT") is registry.backend("paper-tight")
    with pytest.raises(NotInstalled, match="is a str"):
        registry.backend("evalkit_baselines.paper:CITATION")
    of_module, of_name = (registry.hash_run_code(n, "room") for n in ("evalkit_baselines.paper:SPEC", "paper"))
    assert of_module == of_name


def test_a_class_of_a_module_is_checked_like_its_spec(tmp_path, monkeypatch):
    lines = (
        "class Keep:\n    'Answer the guess.'\n    def register(self, target, source, guess): ...\nclass Other: ...\n"
    )
    (tmp_path / "class_of_a_method.py").write_text(lines)
    monkeypatch.syspath_prepend(tmp_path)
    assert backend_at("class_of_a_method:Keep").summary == "Answer the guess."
    with pytest.raises(NotInstalled, match="is a type, expected a BackendSpec or a class with register or update"):
        backend_at("class_of_a_method:Other")


def test_a_module_that_is_not_found_is_named_with_what_to_do(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UnknownName) as caught:
        registry.backend("nowhere.at.all:SPEC")
    known = "(no scheme has this name; known: exec, file, lib)"
    assert str(caught.value) == f"no module nowhere.at.all found: set PYTHONPATH to the folder that has it {known}"
    for file in (Path("nowhere_at_all.py"), Path("nowhere", "at_all", "__init__.py")):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
        module = ".".join(file.parent.parts) or file.stem
        with pytest.raises(UnknownName) as caught:
            registry.backend(f"{module}:SPEC")
        assert str(caught.value) == f"no module {module} found: {file} is in this folder: set PYTHONPATH=. {known}"


def test_a_file_of_this_folder_named_without_its_spec_is_no_unknown_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("trans.py").touch()
    with pytest.raises(UnknownName) as caught:
        registry.backend("trans")
    told = "no backend named 'trans' (trans.py is in this folder: give trans:SPEC, with PYTHONPATH=.); known: "
    assert str(caught.value).startswith(told)


def test_the_fingerprint_covers_the_code_of_both_plug_ins():
    room = registry.hash_run_code("paper", "room")
    assert room == registry.hash_run_code("paper", "room")
    assert room == registry.hash_run_code("paper-tight", "lab")  # the same modules; parameters are hashed elsewhere
    assert len({room, registry.hash_run_code("paper", "carmen"), registry.hash_run_code("wheel-odometry", "room")}) == 3
    assert registry.hash_scoring_code("log-odds") != room


def test_the_fingerprint_of_scores_covers_the_metrics_of_other_packages(points, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    points.append(EntryPoint("log-odds", "evalkit_baselines.paper:MAPPER", "evalkit.mappers"))
    without = registry.hash_scoring_code("log-odds")
    own = Path(tmp_path, "lab_metric.py")
    own.write_text("METRIC = 1")
    points.append(EntryPoint("lab", "lab_metric:METRIC", "evalkit.metrics"))
    registry._find_points.cache_clear()
    before = registry.hash_scoring_code("log-odds")
    own.write_text("METRIC = 2")
    assert len({without, before, registry.hash_scoring_code("log-odds")}) == 3


def test_find_backend_returns_the_spec_and_for_a_broken_plugin_one_with_the_reason(strangers, monkeypatch):
    assert registry.find_backend("paper") is registry.backend("paper")
    assert "the licence server does not answer" in registry.find_backend("unloadable").missing()

    def broken(name):
        raise OSError("no such device")

    monkeypatch.setattr(registry, "backend", broken)
    spec = registry.find_backend("paper")
    assert spec.missing() == "its plug-in failed: OSError: no such device"
    with pytest.raises(NotInstalled, match="cannot be used; its plug-in failed"):
        spec.make()


def test_the_default_mapper_is_the_one_that_declares_itself_the_default(points, monkeypatch):
    def mapper(default):
        return MapperSpec(object, "a mapper", "none", "MIT", default=default)

    for name, default in (("a", False), ("b", True)):
        monkeypatch.setattr(evalkit, name, mapper(default), raising=False)
        points.append(EntryPoint(name, f"evalkit:{name}", "evalkit.mappers"))
    points.append(EntryPoint("0", "nowhere_to_be_found:SPEC", "evalkit.mappers"))
    assert defaults.find_default_mapper() == "b"
    points[:] = points[:1]
    registry._find_points.cache_clear()
    with pytest.raises(NotInstalled, match="no installed mapper is declared as the default"):
        defaults.find_default_mapper()


def test_the_search_path_of_a_run_holds_what_only_pythonpath_finds(strangers, tmp_path, monkeypatch):
    own = Path(__file__).parents[1] / "strangers"
    assert registry.find_search_path("faulty", "room") == registry.find_search_path("paper", "straight") == str(own)
    assert registry.find_search_path("paper", "room") == ""
    (tmp_path / "sought_icp.py").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(["/nowhere", str(tmp_path), *site.getsitepackages()]))
    assert registry.find_search_path("sought_icp:SPEC", "room") == "."
    monkeypatch.delenv("PYTHONPATH")
    assert registry.find_search_path("sought_icp:SPEC", "room") == ""
