"""Fuzz the readers: ``python tests/fuzz/run.py --seconds 60 [TARGET ...]``, guided by coverage if atheris is installed.

Inputs that violate a check are written to files. Without a target all targets are run.
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
    """Run the targets and return 1 if any has a finding."""
    parser = argparse.ArgumentParser(description="Fuzz evalkit's readers.")
    parser.add_argument("targets", nargs="*", help=f"of: {', '.join(names())}; none: all")
    parser.add_argument("--seconds", type=float, default=60.0, help="per target")
    parser.add_argument("--findings", type=Path, default=Path("fuzz-findings"), help="folder for failing inputs")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        return _fuzz(arguments.targets[0], arguments.seconds, arguments.findings)
    found = 0
    for name in arguments.targets or names():
        found += _run_target(name, arguments.seconds, arguments.findings)
    sys.stdout.write(f"{found} with findings" + "\n")
    return min(found, 1)


def names() -> list[str]:
    """Return the names of all targets."""
    return sorted(path.stem for path in (HERE / "targets").glob("[a-z]*.py"))


def _run_target(name: str, seconds: float, findings: Path) -> bool:
    """Fuzz a target in a separate process and print the result; returns whether it has a finding."""
    findings.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, __file__, "--child", "--seconds", str(seconds), "--findings", str(findings), name]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    began = time.monotonic()
    with (findings / f"{name}.txt").open("w+", encoding="utf-8", errors="replace") as log:
        code = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, env=environment, check=False).returncode
        log.seek(0)
        text = log.read()
    runs = re.findall(r"(?:Done (\d+) runs|number_of_executed_units: (\d+)|^#(\d+))", text, re.MULTILINE)
    executed = max((int(number) for each in runs for number in each if number), default=0)
    sys.stdout.write(
        f"{name}: {executed} inputs in {time.monotonic() - began:.0f} s, {'FINDING' if code else 'nothing found'}"
        + "\n"
    )
    if code:
        sys.stdout.write(_extract_reason(text) or f"  see {findings / name}.txt" + "\n")
    return bool(code)


def _extract_reason(text: str) -> str:
    lines = [line for line in text.splitlines() if not line.startswith(("#", "INFO", "stat::", "MS:"))]
    return "\n".join(f"  {line[:300]}" for line in lines[-60:])


def _fuzz(name: str, seconds: float, findings: Path) -> int:
    sys.path[:0] = [str(HERE), str(HERE / "targets")]
    if importlib.util.find_spec("atheris") is None:
        return _fuzz_by_mutation(name, seconds, findings)
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
    atheris.Setup([sys.argv[0], *options, str(corpus)], target.read_input, enable_python_coverage=True)
    atheris.Fuzz()  # does not return
    return 0


def load(name: str):
    """Return the module of a target."""
    for place in (HERE, HERE / "targets"):
        if str(place) not in sys.path:
            sys.path.append(str(place))
    spec = importlib.util.spec_from_file_location(f"targets.{name}", HERE / "targets" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    import bounds

    bounds.free = True
    for seed in module.seeds():  # loads lazily imported modules
        module.read_input(seed)
    bounds.free = False
    return module


def _fuzz_by_mutation(name: str, seconds: float, findings: Path) -> int:
    from mutation import mutants

    target = load(name)
    end, count = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        for data in mutants(target.seeds(), 100, seed=count):
            try:
                target.read_input(data)
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
