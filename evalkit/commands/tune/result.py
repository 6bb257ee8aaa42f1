"""All that a tuning found, as its page and its JSON need it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from evalkit.commands.tune.held_out import Held, held
from evalkit.commands.tune.plan import Tuning
from evalkit.commands.tune.search_loop import Searched
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.standings import STATUS

FAILED = ("failed", "crashed", "timed out", "out of memory")


@dataclass(frozen=True, eq=False)
class Tuned:
    """A tuning, what its search found, and the comparison on held-out sequences; ``report`` makes that in full."""

    tuning: Tuning
    found: Sequence[Searched]
    comparison: Comparison
    ran_on: Mapping[str, str]
    report: str

    @property
    def searched(self) -> tuple[Searched, ...]:
        """Those that had something to search."""
        return tuple(one for one in self.found if one.entrant.space.factors)

    @cached_property
    def held(self) -> Mapping[str, Held]:
        """The verdicts by the back end's label, of those for which something better was found."""
        return {one.label: one for one in held(self.comparison, self.found)}

    @cached_property
    def failed(self) -> tuple[str, ...]:
        """Who completed no run at all, in the search or held out."""
        never = [one.entrant.label for one in self.found if one.failed]
        statuses: dict[str, list[str]] = {}
        for record in self.comparison.records:
            statuses.setdefault(record.method, []).append(STATUS[record.result.status])
        never += [label for label, told in statuses.items() if all(each in FAILED for each in told)]
        return tuple(dict.fromkeys(never))

    def verdict(self, one: Searched) -> str:
        """What is said of a back end in one phrase."""
        if one.failed:
            return "failed: no run of no point was completed"
        return self.held[one.entrant.label].verdict if one.tuned else one.why

    def sentence(self, one: Searched) -> str:
        """The verdict with the numbers it stands on."""
        held = self.held.get(one.entrant.label)
        duel = held.duel if held is not None else None
        if one.failed or duel is None or duel.ratio is None:
            return f"{one.entrant.label}: {self.verdict(one)}"
        numbers = f"error {duel.ratio:.2f} times the default's in the median of {duel.runs} runs, p = {duel.p:.2g}"
        return f"{one.entrant.label}: {self.verdict(one)} ({numbers})"
