"""Copied beside an installed package, the tests that need a checkout are skipped, and no other test of theirs fails."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.checkout
@pytest.mark.slow
def test_the_tests_of_a_checkout_are_skipped_elsewhere(tmp_path):
    job = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    (copied,) = re.findall(r"cp -r --parents (.*) elsewhere/", job)
    for name in copied.split():
        source, target = ROOT / name, tmp_path / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("build", "__pycache__"))
        else:
            shutil.copy(source, target)
    marked = [path for path in (tmp_path / "tests").rglob("test_*.py") if "mark.checkout" in path.read_text("utf-8")]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "checkout", *marked]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    (skipped,) = re.findall(r"^(\d+) skipped, \d+ deselected", done.stdout, re.MULTILINE)
    assert int(skipped) >= 20, done.stdout
    assert (done.returncode, "not in a checkout" in done.stdout) == (0, True), done.stdout
