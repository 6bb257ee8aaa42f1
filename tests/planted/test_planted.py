"""A few of the planted faults are found and named, and the correct library passes; ``make planted`` runs all."""

import importlib.util
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from evalkit.commands.validate.rules import runner
from evalkit.core.errors import BackendFailed
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.plugins import registry

sys.path.append(str(Path(__file__).parent))
examination = importlib.import_module("examination")
faults = importlib.import_module("faults")
_spec = importlib.util.spec_from_file_location("planted_run", Path(__file__).with_name("run.py"))
assert _spec is not None
assert _spec.loader is not None
run = sys.modules["planted_run"] = importlib.util.module_from_spec(_spec)  # other tests have a run.py as well
_spec.loader.exec_module(run)
NAMES = {one.number: one.name for one in faults.FAULTS}

pytestmark = [pytest.mark.slow, pytest.mark.skipif(shutil.which("cc") is None, reason="no compiler 'cc' here")]


@pytest.mark.thorough
@pytest.mark.parametrize("number", [0, 38, 53, 65])
def test_a_planted_difference_is_the_first_one_named_and_the_correct_library_has_none(number, tmp_path):
    texts = examination.compare(examination.build(number, tmp_path), seed=number + 1)["texts"]
    if number == 0:
        assert texts == []
    else:
        assert re.search(NAMES[number], texts[0]), texts


@pytest.mark.parametrize(
    ("number", "rule"),
    [
        (0, ""),
        pytest.param(1, "memory", marks=pytest.mark.thorough),
        (14, "buffers"),
        (15, "bounds"),
        pytest.param(12, "folder", marks=pytest.mark.thorough),
        (86, "few-points"),
    ],
)
def test_a_planted_fault_of_state_or_resources_breaks_its_rule(number, rule, tmp_path):
    backend = examination.build(number, tmp_path, "-O2")
    chosen = (rule,) if rule else ("memory", "buffers", "bounds", "folder", "few-points")
    broken = {one.rule for one in runner.check(backend, only=chosen).broken}
    assert broken - {"alive"} == ({rule} if rule else set())


@pytest.mark.thorough
def test_single_precision_is_named_and_a_constant_error_of_its_size_is_not_excused(tmp_path):
    single = examination.compare(examination.build(0, tmp_path, "-O2 -DSINGLE"), seed=5)["texts"]
    assert single == []
    shifted = examination.compare(examination.build(19, tmp_path), seed=5)["texts"]
    assert all("precision" not in text.partition(": ")[2][:40] for text in shifted)


@pytest.mark.parametrize(("number", "level"), [(0, "pairs of every iteration"), (65, "pairs of every iteration")])
def test_a_library_that_reports_its_pairs_is_compared_by_them(number, level, tmp_path):
    a, b = ({"name": name, "given": {}} for name in ("paper", examination.build(number, tmp_path, "-O1 -DPAIRS")))
    on = {"label": "room", "dataset": "room", "parameters": {"laps": 0.03, "seed": 0}}
    found = examination.probes.compare_pairs(a, b, on, 2, True, ["exact"])["exact"]
    assert found["level"] == level
    assert found["equivalent"] is (number == 0)
    if number:
        assert "does not take the nearest neighbour" in found["first"]["what"]


@pytest.mark.parametrize(
    ("number", "said"), [(513, "wrote beyond its answer"), (524, "wrote to the guess, which is read-only")]
)
def test_a_library_that_writes_where_it_may_not_is_refused(number, said, tmp_path):
    spec = registry.backend(examination.build(number, tmp_path, "-O1", "cc", "single.c"))
    cloud = Cloud(np.random.default_rng(0).uniform(-3.0, 3.0, (20, 2)))
    with pytest.raises(BackendFailed, match=said):
        spec.make(**{one.name: one.default for one in spec.parameters}).register(cloud, cloud, Pose(0.0, 0.0, 2.0))


def test_the_core_is_not_built_with_options_that_it_refuses():
    def fast(source):
        return [one for one in run.planned([source], ()) if "-ffast-math" in one.options]

    assert fast("odometry.c") == []
    assert fast("planted.c") != []


def test_a_program_that_gives_no_answer_is_found_by_the_reason_of_its_refusal():
    (text,) = examination.examine("exec:true", 1)
    assert text.startswith("exec:true: cannot be checked here; ended with code 0 instead of answering")


@pytest.mark.parametrize("source", sorted(faults.LIBRARIES))
def test_every_fault_has_a_number_of_its_own_and_a_variant_in_the_source(source):
    text = (examination.FOLDER / source).read_text(encoding="utf-8")
    numbers = [one.number for one in faults.LIBRARIES[source]]
    assert len(set(numbers)) == len(numbers) >= 10
    found = {int(number) for number in re.findall(r"""(?:F|fault!?)\("?([0-9]+)"?\)""", text)} - {0}
    assert found == set(numbers)


@pytest.mark.parametrize(
    ("source", "compiler", "options"), [("second.cpp", "c++", "-O1"), ("program.rs", "rustc", "-O")]
)
@pytest.mark.parametrize("correct", [True, False])
@pytest.mark.thorough
def test_a_second_and_a_third_implementation_equal_the_reference_and_a_fault_of_each_is_named(
    source, compiler, options, correct, tmp_path
):
    if shutil.which(compiler) is None:
        pytest.skip(f"no compiler {compiler!r} here")
    number, name = {"second.cpp": (215, "16 bits behind the point"), "program.rs": (301, "6 decimals")}[source]
    backend = examination.build(0 if correct else number, tmp_path, options, compiler, source)
    a, b = ({"name": one, "given": {}} for one in ("paper", backend))
    found = examination.question_probes.compare_questions(a, b, 3, ["exact"], True)["exact"]
    assert (found["beyond_rounding"] == 0) is correct
    assert correct or name in found["families"]["scales"]["first"]["what"]


def test_the_page_lists_what_ended_otherwise_than_expected_before_all_builds():
    findings = [
        run.Finding("planted.c", "1 a call leaks", "memory", ("rule memory: 32 bytes",), 3.0),
        run.Finding("planted.c", "2 an instance leaks", "memory", ("rule slowdown: slower",), 4.0),
        run.Finding("planted.c", "3 a file stays open", "open-files", (), 5.0),
        run.Finding("planted.c", "cc -O0", "", (), 6.0),
    ]
    head, unexpected, builds = re.split(r"^## .*\n", "\n".join(run.as_page(findings, 7)), flags=re.MULTILINE)
    assert "| `planted.c` | 96 | 3 | 2 | 1 | 1 | 0 |" in head
    rows = [
        "| `planted.c` | 2 an instance leaks | found | rule slowdown: slower | 4 s |",
        "| `planted.c` | 3 a file stays open | MISSED | nothing | 5 s |",
    ]
    assert unexpected.strip().splitlines()[2:] == rows
    assert "<summary>4 builds</summary>" in builds
    assert builds.count(" s |\n") == 4
