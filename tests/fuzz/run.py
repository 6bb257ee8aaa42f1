"""Fuzzes the readers: ``python tests/fuzz/run.py --seconds 60 [TARGET ...]``, by coverage where atheris is installed.

What breaks a promise is left as a file, and its place is printed. Without a target all take their turn.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import subprocess
import sys
import time
import traceback
from pathlib import Path

HERE = Path(__file__).resolve().parent
INSTRUMENTED = ["evalkit", "evalkit_datasets", "rosbags", "ruamel", "tomllib", "targets"]


def main() -> int:
    """How many targets have a finding."""
    asked = argparse.ArgumentParser(description="Fuzz evalkit's readers.")
    asked.add_argument("targets", nargs="*", help=f"of: {', '.join(names())}; none: all")
    asked.add_argument("--seconds", type=float, default=60.0, help="of each target")
    asked.add_argument("--findings", type=Path, default=Path("fuzz-findings"), help="folder for inputs that break it")
    asked.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    given = asked.parse_args()
    if given.child:
        return _fuzz(given.targets[0], given.seconds, given.findings)
    found = 0
    for name in given.targets or names():
        found += _apart(name, given.seconds, given.findings)
    sys.stdout.write(f"{found} with findings" + "\n")
    return min(found, 1)


def names() -> list[str]:
    """All targets."""
    return sorted(path.stem for path in (HERE / "targets").glob("[a-z]*.py"))


def _apart(name: str, seconds: float, findings: Path) -> bool:
    """Fuzzes a target in a process of its own, and tells how that ended."""
    findings.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, __file__, "--child", "--seconds", str(seconds), "--findings", str(findings), name]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    began = time.monotonic()
    with (findings / f"{name}.txt").open("w+", encoding="utf-8", errors="replace") as said:
        code = subprocess.run(command, stdout=said, stderr=subprocess.STDOUT, env=environment, check=False).returncode
        said.seek(0)
        text = said.read()
    runs = re.findall(r"(?:Done (\d+) runs|number_of_executed_units: (\d+)|^#(\d+))", text, re.MULTILINE)
    executed = max((int(number) for each in runs for number in each if number), default=0)
    sys.stdout.write(
        f"{name}: {executed} inputs in {time.monotonic() - began:.0f} s, {'FINDING' if code else 'nothing found'}"
        + "\n"
    )
    if code:
        sys.stdout.write(_reason(text) or f"  see {findings / name}.txt" + "\n")
    return bool(code)


def _reason(text: str) -> str:
    lines = [line for line in text.splitlines() if not line.startswith(("#", "INFO", "stat::", "MS:"))]
    return "\n".join(f"  {line[:300]}" for line in lines[-60:])


def _fuzz(name: str, seconds: float, findings: Path) -> int:
    sys.path[:0] = [str(HERE), str(HERE / "targets")]
    if importlib.util.find_spec("atheris") is None:
        return _by_damage(name, seconds, findings)
    import atheris

    with atheris.instrument_imports(include=INSTRUMENTED):
        target = load(name)
    corpus = findings / f"{name}-corpus"
    corpus.mkdir(exist_ok=True)
    for number, seed in enumerate(target.seeds()):
        (corpus / f"seed-{number}").write_bytes(seed)
    words = findings / "words.dict"
    words.write_text(_dictionary(), encoding="ascii")
    options = [
        f"-max_total_time={seconds:g}", "-timeout=30", "-rss_limit_mb=1500", "-print_final_stats=1", "-max_len=20000",
        f"-dict={words}", f"-artifact_prefix={findings / name}-",
    ]  # fmt: skip
    atheris.Setup([sys.argv[0], *options, str(corpus)], target.one, enable_python_coverage=True)
    atheris.Fuzz()  # which ends the process
    return 0


def load(name: str):
    """The module of a target."""
    for place in (HERE, HERE / "targets"):
        if str(place) not in sys.path:
            sys.path.append(str(place))
    spec = importlib.util.spec_from_file_location(f"targets.{name}", HERE / "targets" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    import bounds

    bounds.free = True
    for seed in module.seeds():  # which loads what is loaded when it is needed
        module.one(seed)
    bounds.free = False
    return module


def _by_damage(name: str, seconds: float, findings: Path) -> int:
    from mutation import mutants

    target = load(name)
    end, count = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        for data in mutants(target.seeds(), 100, seed=count):
            try:
                target.one(data)
            except BaseException:  # noqa: BLE001 - whatever it is, it is the finding
                (findings / f"{name}-crash-{count}").write_bytes(data)
                traceback.print_exc()
                return 1
        count += 100
    sys.stdout.write(f"Done {count} runs" + "\n")
    return 0


def _dictionary() -> str:
    from mutation import WORDS

    return "".join('"' + "".join(f"\\x{byte:02x}" for byte in word) + '"\n' for word in WORDS if len(word) < 60)


if __name__ == "__main__":
    sys.exit(main())
