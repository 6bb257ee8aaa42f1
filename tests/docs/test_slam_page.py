"""The SLAM printed in the documentation is shorter than 100 lines, follows the rules, and spreads its correction."""

import importlib.util
import sys

import numpy as np
import pytest

site = pytest.importorskip("evalkit_docs.site", reason="the documentation is not part of a wheel")

from evalkit import Frame, LoopClosure, OdometryEstimate, Pose, Scan, Trajectory  # noqa: E402 - as above
from evalkit.commands.validate.rules import odometry_rules, slam_rules  # noqa: E402 - as above
from evalkit.commands.validate.rules.rule import check_rule  # noqa: E402 - as above
from evalkit_docs import blocks as code  # noqa: E402 - as above

PAGE = site.PAGES / "slam.md"
(EXAMPLE,) = (one for one in code.find_blocks(PAGE.read_text(encoding="utf-8")) if one.title == "ring_slam.py")


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    path = tmp_path_factory.mktemp("example") / "ring_slam.py"
    path.write_text(EXAMPLE.content, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("ring_slam", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["ring_slam"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["ring_slam"]


def test_the_example_is_short_and_follows_the_rules_of_a_slam(example, monkeypatch):
    monkeypatch.setattr(slam_rules, "SCANS", 60)  # once around
    assert len(EXAMPLE.content.splitlines()) < 100
    fixture = slam_rules.SlamFixture(example.SPEC.make)
    own = {name: rule for name, rule in slam_rules.RULES.items() if name not in odometry_rules.RULES}
    results = {name: check_rule(rule, fixture) for name, rule in own.items()}
    assert {name: one.observed for name, one in results.items() if one.outcome == "failed"} == {}
    assert [one.accepted for one in fixture.first_run.closures] == [True]


def test_the_example_spreads_a_correction_over_the_path(example, monkeypatch):
    slam = example.RingSlam()
    slam._stamps, slam._path = list(range(11)), [0.4 * k for k in range(11)]
    slam._poses = [np.array([0.4 * k, 0.0, 0.0]) for k in range(11)]
    slam._scans = {0: np.zeros((0, 2))}
    monkeypatch.setattr(example, "match", lambda *_: (Pose(4.0, 0.2, 0.0), 0.9))
    slam._close(np.zeros((0, 2)))
    np.testing.assert_allclose(slam.trajectory().poses[:, 1], 0.02 * np.arange(11), atol=1e-12)
    assert slam.loop_closures() == (LoopClosure(10, 0, Pose(4.0, 0.2, 0.0), True, "90 % of the points fit"),)
    monkeypatch.setattr(example, "match", lambda *_: (Pose(), 0.6))
    slam._close(np.zeros((0, 2)))
    assert [one.accepted for one in slam.loop_closures()] == [True, False]


@pytest.mark.parametrize("kind", [Frame, Scan, OdometryEstimate, Trajectory, LoopClosure])
def test_the_page_lists_every_field_of_the_values(kind):
    text = PAGE.read_text(encoding="utf-8")
    missing = [name for name in kind.__dataclass_fields__ if f"`{name}`" not in text]
    assert missing == []
