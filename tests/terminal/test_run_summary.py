"""What follows a comparison: the next command."""

from types import SimpleNamespace

from evalkit.core.run_status import RunStatus
from evalkit.terminal.run_summary import _name_next_step

SEQUENCE = SimpleNamespace(dataset="lab-logs", parameters={"path": "my drive.log", "limit": 0})


def run_of(backend, status, reason=""):
    spec = SimpleNamespace(method=SimpleNamespace(backend=backend), sequence=SEQUENCE)
    return spec, SimpleNamespace(status=status, reason=reason, is_complete=status == RunStatus.COMPLETE)


def test_without_a_complete_run_the_next_command_asks_why_the_first_one_failed():
    failed = run_of("exec:./mine -x", RunStatus.CRASHED)
    said = _name_next_step([run_of("absent", RunStatus.NOT_INSTALLED), failed], "results")
    assert said == "evalkit validate 'exec:./mine -x' --only rules (why no run is complete)"
    assert _name_next_step([failed, run_of("paper", RunStatus.COMPLETE)], "results").startswith(
        "evalkit export results"
    )


def test_where_methods_fail_for_the_same_reason_the_data_are_to_be_checked():
    failed = [run_of(name, RunStatus.FAILED, "ValueError: ranges") for name in ("paper", "wheel-odometry")]
    said = "evalkit validate lab-logs --set 'path=my drive.log' (the data: several methods failed for the same reason)"
    assert _name_next_step(failed, "results") == said
    made = SimpleNamespace(dataset="made", parameters={})
    without = [(SimpleNamespace(method=spec.method, sequence=made), result) for spec, result in failed]
    assert _name_next_step(without, "results").startswith("evalkit validate made (the data")
    others = (
        failed[0],
        run_of("ndt", RunStatus.FAILED, "another"),
        run_of("paper", RunStatus.FAILED, "ValueError: ranges"),
    )
    assert _name_next_step(others, "results").startswith("evalkit validate paper --only rules")
    killed = [run_of(name, RunStatus.CRASHED, "killed by signal 9") for name in ("paper", "ndt")]
    assert _name_next_step(killed, "results").startswith("evalkit validate paper --only rules")
