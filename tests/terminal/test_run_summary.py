"""What follows a comparison: the next command."""

from types import SimpleNamespace

from evalkit.core.run_status import RunStatus
from evalkit.terminal.run_summary import _name_next_step


def run_of(backend, status):
    spec = SimpleNamespace(method=SimpleNamespace(backend=backend))
    return spec, SimpleNamespace(status=status, is_complete=status == RunStatus.COMPLETE)


def test_without_a_complete_run_the_next_command_asks_why_the_first_one_failed():
    failed = run_of("exec:./mine -x", RunStatus.CRASHED)
    said = _name_next_step([run_of("absent", RunStatus.NOT_INSTALLED), failed], "results")
    assert said == "evalkit validate 'exec:./mine -x' --only rules (why no run is complete)"
    assert _name_next_step([failed, run_of("paper", RunStatus.COMPLETE)], "results").startswith(
        "evalkit export results"
    )
