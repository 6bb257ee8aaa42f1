"""Shared fixtures: a made-up comparison for the report, the browser that opens it, and third-party plug-ins."""

from __future__ import annotations

import contextlib
import gc
import os
import platform
import shutil
import signal
import struct
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import hypothesis
import numpy as np
import psutil
import pytest

from evalkit.config.experiment import Method, RunSpec, SequenceSpec
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, RunResult, Score, Scores
from evalkit.core.run_status import Cause, RunStatus
from evalkit.core.scan import Frame, Scan
from evalkit.core.trajectory import Trajectory
from evalkit.execution import subprocesses
from evalkit.execution.one_run import STEPS, Request, execute_request
from evalkit.metrics.metric import Group, Metric
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.specs import DatasetSpec, Published
from evalkit.report import Comparison, MethodCard, SequenceCard, Setting
from evalkit.results.run_record import RunRecord
from evalkit.results.store import whole_records

Build = Callable[..., Comparison]

pytest_plugins = ["pytester"]

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as in a background job; processes started by tests inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


hypothesis.settings.register_profile(  # a busy machine is no finding
    "evalkit", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("evalkit")

CHECKOUT = all((Path(__file__).parents[1] / name).is_dir() for name in ("evalkit", "docs", ".ci", ".github"))

PATIENCE_S = 300.0
"""How long a test waits for what comes at once on an idle machine: it ends a test that would wait for ever."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the slowest files first: no worker begins one when the others have ended."""
    seconds: dict[Path, float] = {}
    for item in items:
        for marker in item.iter_markers("slow"):
            seconds[item.path] = max(seconds.get(item.path, 0.0), *marker.args, 1.0)
    items.sort(key=lambda item: -seconds.get(item.path, 0.0))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip the tests of a checkout where the tests are copied beside an installed package."""
    if not CHECKOUT and item.get_closest_marker("checkout"):
        pytest.skip("not in a checkout")


def pytest_collection_finish() -> None:
    """Exempt what collection has made from garbage collection, which would visit it in every test that collects."""
    gc.collect()
    gc.freeze()


UNITS: tuple[tuple[str, str, str, str, Group, int, bool], ...] = (
    ("ate_rmse_m", "ATE RMSE", "m", "lower", "drift", 3, True),
    ("drift_percent", "drift per metre", "%", "lower", "drift", 2, True),
    ("heading_rmse_deg", "heading RMSE", "deg", "lower", "drift", 2, False),
    ("relations_mean_m", "relation error, mean", "m", "lower", "relations", 3, True),
    ("relations_sd_m", "relation error, sd", "m", "lower", "relations", 3, False),
    ("map_f1", "map F1 at 10 cm", "", "higher", "map against truth", 3, True),
    ("map_entropy", "map entropy", "nat", "lower", "map consistency", 4, False),
    ("wall_thickness_m", "wall thickness", "m", "lower", "map consistency", 3, False),
    ("split_distance_m", "halves of the run apart", "m", "lower", "map consistency", 3, True),
    ("cleared_percent", "free-space violation", "%", "lower", "map consistency", 2, False),
    ("mom_cm2", "orthogonal walls' variance", "cm2", "lower", "map consistency", 1, True),
    ("guess_kept_percent", "guess kept", "%", "lower", "residuals", 1, True),
    ("s2m_m", "S2M residual", "m", "lower", "residuals", 4, True),
    ("cpu_median_ms", "CPU time per scan, median", "ms", "lower", "runtime", 2, True),
    ("corners", "corners", "", "", "map consistency", 0, False),
)


def metric_table() -> tuple[Metric, ...]:
    """Metrics of every group and direction."""
    return tuple(
        Metric(
            name, label, unit, better, group, f"What {label} is.", "Author 2012", "global warp", _unused, digits, head
        )  # type: ignore[arg-type]
        for name, label, unit, better, group, digits, head in UNITS
    )


def make_record(
    method: str,
    sequence: str,
    scores: Mapping[str, float | None],
    *,
    seed: int | None = 0,
    status: RunStatus = "complete",
    reason: str = "",
    answered: int = 60,
    expected: int = 60,
    error_m: float = 0.02,
    ms: float = 1.0,
    truth: bool = True,
) -> RunRecord:
    """Return a run around a rectangle whose estimate drifts from the ground truth by ``error_m``."""
    stamps = np.arange(expected) * 100_000_000
    poses = _lap(np.linspace(0.0, 1.0, expected))
    rng = np.random.default_rng([seed or 0, *method.encode()])
    off = error_m * np.linspace(0.0, 1.0, expected)[:, None] * [0.7, -0.7, 0.05] + rng.normal(0, 0.002, (expected, 3))
    steps = np.zeros(answered, dtype=STEP)
    for column, values in zip(("x", "y", "theta"), (poses + off).T, strict=True):
        steps[column] = values[:answered]
    steps["stamp_ns"] = stamps[:answered]
    steps["cpu_ns"] = rng.lognormal(0.0, 0.4, answered) * ms * 1e6
    steps["wall_ns"] = steps["cpu_ns"]
    steps["s2s_error"] = np.nan if method.startswith("wheel") else rng.gamma(9, 0.002, answered)
    steps["s2m_error"] = np.nan if method.startswith("wheel") else rng.gamma(9, 0.003, answered)
    cause = next(cause for cause in Cause if cause.status == status)
    result = RunResult(steps, expected, cause, reason, 120_000_000, 5, {"scans out of order": 2})
    key = f"{method}-{sequence}-{seed}".replace("<", "_").replace(">", "_").replace("/", "_")
    spec = RunSpec(
        key,
        Method(method, method, {"keyframes": 10}),
        SequenceSpec(sequence, sequence, {"rate_hz": 10.0}, (seed,)),
        seed,
    )
    command = f"evalkit compare demo.toml --sequence '{sequence}' --method '{method}'"
    by_metric = {n: Score(v, answered) if v is not None else Score(None, 0, f"no {n} here") for n, v in scores.items()}
    errors = _errors(np.hypot(off[:answered, 0], off[:answered, 1]), scores) if truth and answered else None
    return RunRecord(
        spec,
        result,
        Scores(by_metric, Pose(), "", _grid(error_m) if answered else None, errors),
        _truth(stamps, poses) if truth else Truth("none"),
        command + ("" if seed is None else f" --seed {seed}"),
    )


def _errors(errors_m: np.ndarray, scores: Mapping[str, float | None]) -> np.ndarray:
    """Return errors with the given ATE, if one is given."""
    ate = scores.get("ate_rmse_m")
    return errors_m if ate is None else errors_m * ate / np.sqrt(np.mean(errors_m**2))


def make_comparison(records: Sequence[RunRecord], **changes: object) -> Comparison:
    """Return a comparison of records with plain cards; the methods "paper" and "wheel" have their roles."""
    roles = {"paper": "reference", "wheel": "baseline"}
    made = Comparison(
        title="Demo",
        description="Nine ways to follow a lidar.",
        records=tuple(records),
        metrics=metric_table(),
        methods={
            label: MethodCard(
                f"What {label} does.",
                "Author, https://example.org/paper",
                "MIT",
                (Setting("keyframes", 20, 10, "", "how many"), Setting("radius", 0.3, 0.3, "m", "search radius")),
                "wheel odometry",
                role=roles.get(label, ""),  # type: ignore[arg-type]
            )
            for label in dict.fromkeys(record.method for record in records)
        },
        sequences={
            label: SequenceCard(f"A sequence called {label}.", "360 beams, 10 Hz", "exact: simulated", "Author", "MIT")
            for label in dict.fromkeys(record.sequence for record in records)
        },
        environment={"processor": "a processor", "threads per run": "1"},
        command="evalkit compare demo.toml",
        started=datetime(2024, 5, 1, 8, 0, tzinfo=UTC),
        finished=datetime(2024, 5, 1, 9, 30, tzinfo=UTC),
        mapper="log-odds (resolution_m 0.05)",
        fairness=("One thread each.",),
    )
    return replace(made, **changes)  # type: ignore[arg-type]


BROWSERS = ("chromium-headless-shell", "chromium", "google-chrome", "google-chrome-stable", "chromium-browser")
"""The first takes a third of the time of the second."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Return the browser that opens pages; while it is open, nothing else in this process may use asyncio."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install playwright"
    )
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        pytest.skip(f"no browser found, none of: {', '.join(BROWSERS)}")
    with playwright.sync_playwright() as running:
        started = running.chromium.launch(
            executable_path=program, args=["--no-sandbox", "--disable-gpu"], timeout=1e3 * PATIENCE_S
        )
        yield _PatientBrowser(started)
        started.close()


class _PatientBrowser:
    """A browser whose pages wait long enough for a busy machine."""

    def __init__(self, browser: Any) -> None:
        self._browser = browser

    def new_context(self, **options: Any) -> Any:
        """Open a context."""
        context = self._browser.new_context(**options)
        context.set_default_timeout(1e3 * PATIENCE_S)
        return context

    def new_page(self, **options: Any) -> Any:
        """Open a page in a context of its own."""
        page = self._browser.new_page(**options)
        page.set_default_timeout(1e3 * PATIENCE_S)
        return page


@pytest.fixture(scope="session")
def record() -> Callable[..., RunRecord]:
    """Return ``record(method, sequence, scores, ...)``."""
    return make_record


@pytest.fixture(scope="session")
def build() -> Build:
    """Return ``build(records, ...)``, which makes a comparison."""
    return make_comparison


@pytest.fixture(scope="session")
def demo() -> Comparison:
    """Two sequences, three seeds and one run, with every status and a name that contains a script."""
    records = []
    for seed in range(3):
        for name, ate, ms in (("paper", 0.066, 0.3), ("plane", 0.011, 4.2), ("wheel", 0.39, 0.01), ("lost", 2.5, 9.0)):
            value = ate * (1 + 0.03 * seed)
            scores = {
                "ate_rmse_m": value, "drift_percent": 10 * value, "heading_rmse_deg": value, "relations_mean_m": None,
                "map_f1": 1 / (1 + 4 * value), "map_entropy": 0.1 + value / 9, "cpu_median_ms": ms, "corners": 40.0,
                "s2m_m": None if name == "wheel" else 0.02,
                "wall_thickness_m": 0.02, "split_distance_m": 0.05, "guess_kept_percent": 0.0,
            }  # fmt: skip
            records.append(make_record(name, "room", scores, seed=seed, error_m=ate, ms=ms))
        ends: tuple[tuple[RunStatus, str, int], ...] = (
            ("complete", "", 60), ("crashed", "signal 11 (segmentation fault)", 31), ("timeout", "900 s passed", 45),
        )  # fmt: skip
        status, reason, answered = ends[seed]
        records.append(
            make_record(
                "<script>alert(1)</script>",
                "room",
                {"ate_rmse_m": 0.05, "cpu_median_ms": 50.0},
                seed=seed,
                status=status,
                reason=reason,
                answered=answered,
                error_m=0.05,
                ms=50.0,
            )
        )
        records.append(
            make_record(
                "absent",
                "room",
                {},
                seed=seed,
                status="not-installed",
                answered=0,
                reason="no module named 'absent'; pip install absent",
            )
        )
    for name, error in (("paper", 0.27), ("plane", 0.051), ("lost", 0.062)):
        scores = {"ate_rmse_m": None, "relations_mean_m": error, "relations_sd_m": error, "cpu_median_ms": 1.0}
        records.append(make_record(name, "fr079", scores, seed=None, error_m=error, truth=False))
    records.append(
        make_record("wheel", "fr079", {}, seed=None, status="failed", reason="no odometry was recorded", answered=0)
    )
    records.append(
        make_record(
            "plane",
            "intel",
            {},
            seed=None,
            status="data-missing",
            answered=0,
            expected=0,
            reason="intel: no such folder; run: evalkit data get intel",
        )
    )
    made = make_comparison(records)
    paper = "Kuemmerle et al. 2009, https://example.org/relations"
    published = (Published("scan matching", 0.258, 0.427, paper), Published("graph mapping", 0.056, 0.042, paper))
    cards = {**made.sequences, "fr079": replace(made.sequences["fr079"], published=published, defects=("odd",))}
    return replace(made, sequences=cards)


def _unused(evidence: object) -> Score:
    raise AssertionError("a report scores nothing")


def _lap(share: np.ndarray) -> np.ndarray:
    angle = 2 * np.pi * share
    return np.stack([6 + 4 * np.cos(angle), 4 + 2.5 * np.sin(angle), angle], axis=-1)


def _truth(stamps: np.ndarray, poses: np.ndarray) -> Truth:
    return Truth("exact: simulated", Trajectory(stamps, poses), grid=_grid(0.0))


def _grid(blur_m: float) -> OccupancyGrid:
    """Return a room of 12 x 8 m at 5 cm, with walls doubled at a distance that grows with the blur."""
    log_odds = np.full((160, 240), -3.0, dtype=np.float32)
    for shift in {0, min(round(blur_m / 0.05), 30)}:
        log_odds[shift, :] = log_odds[-1 - shift, :] = log_odds[:, shift] = log_odds[:, -1 - shift] = 3.0
        log_odds[60:80, 100 + shift] = 3.0
    observed = np.ones_like(log_odds, dtype=bool)
    observed[62:78, 105:130] = False
    return OccupancyGrid(log_odds, observed, 0.05, 0.0, 0.0)


@pytest.fixture(scope="module")
def strangers() -> Iterator[None]:
    """Install third-party plug-ins (tests/strangers) for this process and its children."""
    folder = Path(__file__).parent / "strangers"
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH", "")])))
        yield


@pytest.fixture(scope="module")
def scoring_in_threads() -> Iterator[None]:
    """Score runs and compute tasks in threads of this process, where a test does not concern the processes of pools.

    A run still has a process of its own.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subprocesses, "start_process", lambda _core: ThreadPoolExecutor(1))
        yield


class SquareRoom:
    """A 5 m square room, 40 scans of 180 beams, 100 ms and 4 cm apart; wheel odometry drifts half a cm per scan."""

    stamps_ns = np.arange(40) * 100_000_000
    drift_m = 0.005 * np.arange(40)
    truth = np.stack([0.04 * np.arange(40), np.zeros(40), 0.01 * np.arange(40)], axis=1)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def frames(self) -> Iterator[Frame]:
        """Return the frames; the sensor is at the base."""
        angles = np.linspace(-3.1, 3.1, 180)
        for index, (x, y, theta) in enumerate(self.truth.tolist()):
            cos, sin = np.cos(angles + theta), np.sin(angles + theta)
            ranges = np.minimum((2.5 - np.sign(cos) * x) / np.abs(cos), (2.5 - np.sign(sin) * y) / np.abs(sin))
            scan = Scan(int(self.stamps_ns[index]), ranges, angles, 0.1, 10.0)
            yield Frame(scan, odom_from_base=Pose(x + self.drift_m[index], y, theta))

    def notes(self) -> dict[str, int]:
        """Return no notes."""
        return {}


@pytest.fixture
def run_backend(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return ``run_backend(name, **parameters)``: result and steps of a back end in a square room, in this process."""
    room = DatasetSpec(SquareRoom, "", "", "", "", "")  # type: ignore[arg-type]  # nobody asks for its truth

    def follow(name: str, **parameters: Any) -> tuple[RunResult, Any]:
        complete = frontend.complete_parameters(name, registry.backend(name), parameters)
        folder = Path(mkdtemp(dir=tmp_path))
        with monkeypatch.context() as patched:
            patched.setattr(registry, "dataset", lambda _name: room)
            outcome = execute_request(Request(name, complete, "square", {}), folder)
        steps = folder / STEPS  # absent where the back end was not made
        return outcome, whole_records(steps.read_bytes() if steps.exists() else b"")

    follow.truth, follow.drift_m = SquareRoom.truth, SquareRoom.drift_m  # type: ignore[attr-defined]
    return follow


@pytest.fixture(scope="session")
def wait_for() -> Callable[[Callable[[], Any]], bool]:
    """Return a function that waits until a condition is true; False after ``PATIENCE_S``."""

    def wait(is_true: Callable[[], Any]) -> bool:
        until = time.monotonic() + PATIENCE_S
        while not is_true():
            if time.monotonic() > until:
                return False
            time.sleep(0.01)
        return True

    return wait


@pytest.fixture(scope="session")
def has_ended(wait_for: Callable[[Callable[[], Any]], bool]) -> Callable[[int], bool]:
    """Return a function that waits for the end of a process, which may be a stranger's zombie then."""

    def is_over(pid: int) -> bool:
        try:
            return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
        except psutil.NoSuchProcess:
            return True

    return lambda pid: wait_for(lambda: is_over(pid))


class CallCount:
    """Counts the functions that this thread calls, in Python and in C: a cost that no other program changes."""

    def __init__(self) -> None:
        self.calls = 0

    def _count(self, _frame: object, event: str, _argument: object) -> None:
        self.calls += event.endswith("call")

    @contextlib.contextmanager
    def counting(self) -> Iterator[None]:
        """Count from here on."""
        before = sys.getprofile()
        sys.setprofile(self._count)
        try:
            yield
        finally:
            sys.setprofile(before)


@pytest.fixture
def call_count() -> CallCount:
    """A count of calls, from 0 on."""
    return CallCount()


@pytest.fixture
def foreign_elf() -> bytes:
    """The header of a shared library for another machine than this one: 64-bit RISC-V, or ARM on RISC-V."""
    number = 0xB7 if platform.machine() == "riscv64" else 0xF3
    return b"\x7fELF\x02\x01\x01" + bytes(9) + struct.pack("<HH", 3, number) + bytes(44)
