"""The verdicts on the paper's items: each is a function of measured numbers, and each can be "not reproduced"."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from scipy.stats import ttest_1samp

from evalkit_paper.chapter import Judgement

EXACT = 1e-6
"""Largest difference of a formula that holds to rounding (cells are single precision)."""

MAX_SIGMAS = 3.0
"""Largest deviation of a printed number in standard deviations over the seeds, beyond its rounding."""

STEADY_M = (0.02, 0.03)
"""Range of the scan-to-scan error that the text on Figure 9 states (m)."""

SHORT_S = 2.0
"""Longest duration (s) of a short-lived spike."""

LIMITED_PERCENT = 1.0
"""Drift that counts as limited: percent of the path after one lap."""

LIGHT_SHARE = 0.1
"""A map update is light if it takes at most this share of the time between two scans."""

OPEN_F1 = 0.02
"""A smaller difference of F1 is none."""

WALLS_F1 = 0.5
"""F1 of the walls at 10 cm below which a map does not show the place."""


def judge(holds: bool, why: str, otherwise: str, correction: str = "") -> Judgement:
    """Reproduced (with the correction, if one is needed) where it holds, else not reproduced."""
    if not holds:
        return Judgement("not reproduced", otherwise)
    return Judgement("reproduced with a correction" if correction else "reproduced", why, correction)


# --- equations


def judge_formula(largest: float) -> Judgement:
    """A formula whose largest difference from an independent computation is known."""
    return judge(
        largest <= EXACT, f"differs by at most {max(largest, 1e-16):.0e} from an independent computation",
        f"differs by {largest:.2g} from an independent computation",
    )  # fmt: skip


def judge_correction(printed: float, corrected: float, correction: str) -> Judgement:
    """A formula of which the shares of successes are known, as printed and corrected: all must succeed."""
    if printed == 1.0:
        return Judgement("reproduced", "as printed it succeeds every time")
    text = f"it succeeds in {100 * printed:.0f} % of the cases as printed, in {100 * corrected:.0f} % corrected"
    return judge(corrected == 1.0, text, text, correction)


def judge_subsets(pairs: float, targets: float) -> Judgement:
    """Equation 2's subsets of equal size: pairs and different reference points after the one-to-one filter."""
    return judge(
        pairs == targets > 0, "the filter leaves as many points as reference points",
        f"{pairs:g} points share {targets:g} reference points",
    )  # fmt: skip


def judge_error(printed_sigmas: float, mean_sigmas: float) -> Judgement:
    """Equation 5 against the last error of Table 1: deviations of the mean square and of the mean distance."""
    if printed_sigmas <= MAX_SIGMAS:
        return Judgement("reproduced", "the mean square gives the last error of Table 1")
    text = f"the mean square misses the last error of Table 1 by {printed_sigmas:.0f} sigma, the mean distance by "
    text += f"{mean_sigmas:.1f}"
    return judge(mean_sigmas <= MAX_SIGMAS, text, text, "mean distance (m) instead of mean squared distance")


def judge_error_time(after_sigmas: float, before_sigmas: float) -> Judgement:
    """Error after or before the step: deviations of the iterations of Table 1."""
    fitting = [name for name, off in (("after", after_sigmas), ("before", before_sigmas)) if off <= MAX_SIGMAS]
    if len(fitting) == 2:
        return Judgement("not determined by the text", "both give the iterations of Table 1")
    return judge(bool(fitting), "only one gives the iterations of Table 1", "neither gives the iterations of Table 1",
                 f"the error is computed {''.join(fitting)} the step")  # fmt: skip


def judge_free_space(wrong: float) -> Judgement:
    """Equation 10 as printed: share of truly free cells that the map marks as occupied."""
    text = f"{100 * wrong:.1f} % of the truly free cells are marked occupied"
    return judge(wrong <= 0.05, f"added as printed, l_free clears free space: {text}", text)


# --- figures 2 to 8 and Table 1


def judge_stages(ran: Sequence[str], wanted: Sequence[str]) -> Judgement:
    """A flow chart: the stages of the figure must have run, in its order."""
    missing = [stage for stage in wanted if stage not in ran]
    if missing:
        return Judgement("not reproduced", f"did not run: {', '.join(missing)}")
    order = [ran.index(stage) for stage in wanted]
    return judge(order == sorted(order), "the running code calls its stages in this order", "they ran in another order")


def judge_number(sigmas: float, correction: str = "") -> Judgement:
    """A printed number that deviates from the mean over the seeds by so many standard deviations."""
    text = f"{sigmas:.1f} standard deviations off, beyond its rounding"
    return judge(sigmas <= MAX_SIGMAS, text, text, correction)


def judge_convergence(converged: float, sigmas: float, correction: str) -> Judgement:
    """Figure 6: share of seeds that converge, and deviation of its first and last error."""
    text = f"{100 * converged:.0f} % of the seeds converge; its ends are at most {sigmas:.1f} standard deviations off"
    return judge(converged == 1.0 and sigmas <= MAX_SIGMAS, text, text, correction)


def judge_extents(before_m: float, after_m: float) -> Judgement:
    """Figure 8: extents of the scan before (14 m) and after (10 m) the registration, printed in whole metres."""
    fits = abs(before_m - 14.0) <= 0.5 and abs(after_m - 10.0) <= 0.5
    return judge(fits, "the same whole metres", "another extent in whole metres")


def judge_overlap(
    plain: Mapping[float, float], limited: Mapping[float, float], least: float, correction: str
) -> Judgement:
    """Partial overlap: shares of successes by overlap, with all pairs and with near pairs only.

    From the overlap ``least`` up every start must succeed.
    """
    for shares, change in ((plain, ""), (limited, correction)):
        if all(share == 1.0 for overlap, share in shares.items() if overlap >= least):
            lowest = min(overlap for overlap, share in shares.items() if share == 1.0)
            return judge(True, f"every start succeeds down to an overlap of {100 * lowest:.0f} %", "", change)
    return Judgement("not reproduced", f"not every start succeeds from an overlap of {100 * least:.0f} % up")


def judge_initial_guess(faster: float, fewer_misled: float) -> Judgement:
    """A better guess against a worse one: p-values of fewer iterations and of fewer wrong minima."""
    failed = [word for word, p in (("iterations", faster), ("wrong minima", fewer_misled)) if not p < 0.05]
    text = f"fewer iterations with p = {faster:.1g}, fewer wrong minima with p = {fewer_misled:.1g}"
    return judge(not failed, text, f"not significantly: {text}")


# --- the two stages, Figures 9 and 10


def judge_two_stages(readings_m: Collection[float], odometry_m: float) -> Judgement:
    """Drift (m) of the readings of the text against wheel odometry alone."""
    if min(readings_m) >= odometry_m:
        return Judgement("not reproduced", "no reading of the text is better than wheel odometry alone")
    if max(readings_m) >= odometry_m:
        why = "some readings of the text are better than wheel odometry alone, others are not"
        return Judgement("not determined by the text", why)
    if max(readings_m) <= 1.5 * min(readings_m):
        why = "all readings of the text drift about as much, and less than wheel odometry alone"
        return Judgement("reproduced", why)
    return Judgement("not determined by the text", "the drift depends on the local map and the threshold's unit, "
                     "neither of which is printed")  # fmt: skip


def judge_steady(ranges_m: Mapping[str, tuple[float, float]], correction: str) -> Judgement:
    """S2S "stable in the range 0.02-0.03": lowest and highest median (m) at each lidar rate."""
    inside = [name for name, (low, high) in ranges_m.items() if STEADY_M[0] <= low and high <= STEADY_M[1]]
    if inside and len(inside) < len(ranges_m):
        why = f"inside at {', '.join(inside)} only; the text does not name the rate"
        return Judgement("not determined by the text", why)
    return judge(bool(inside), "inside at every rate", "outside at every rate", correction)


def judge_low(ratio: float) -> Judgement:
    """S2M "remains low during steady motion": its steady median as a share of that of S2S, the largest of all rates."""
    text = f"its steady median is at most {ratio:.2f} of that of S2S"
    return judge(ratio < 1.0, text, text)


def judge_spikes(hit: int, turns: int, longest_s: float, calm: int) -> Judgement:
    """S2M "short-lived spikes during turning phases": turns with a spike, the longest, and spikes in calm motion."""
    text = f"{hit} of {turns} turns, back after at most {longest_s:.1f} s, {calm} spikes in steady motion"
    return judge(hit > 0 and longest_s <= SHORT_S and calm == 0, text, text)


def judge_map(shares: Mapping[str, float], f1: float) -> Judgement:
    """Figure 10: shares of ghost cells along "paper" and "odometry", and F1 of the paper's map."""
    text = f"{100 * shares['paper']:.1f} % ghost cells, {100 * shares['odometry']:.1f} % along odometry, F1 {f1:.2f}"
    return judge(shares["paper"] < shares["odometry"] and f1 >= WALLS_F1, text, text)


# --- claims


def judge_difference(differences: Sequence[float], what: str) -> Judgement:
    """A claim that a value is larger: paired differences over the repetitions, by a one-sided t-test at 5 %."""
    text = f"{what}: by {np.mean(differences):.2g} on average, in {sum(d > 0.0 for d in differences)} of "
    text += f"{len(differences)} repetitions"
    if len(differences) < 3 or np.ptp(differences) == 0.0:
        p = 0.0 if len(differences) >= 3 and differences[0] > 0.0 else 1.0
    else:
        p = float(ttest_1samp(differences, 0.0, alternative="greater").pvalue)
    return judge(p < 0.05, f"{text} (p = {p:.1g})", f"{text} (p = {p:.1g}), not beyond their spread")


def judge_loops(printed_percent: float, reading_percent: float, correction: str) -> Judgement:
    """Limited drift: the largest error after one lap in percent of the path, as printed and as Table 1 implies."""
    text = f"limited is read as at most {LIMITED_PERCENT:g} % of one lap in every repetition; without loop closure the "
    text += "drift keeps growing"
    if printed_percent <= LIMITED_PERCENT:
        return Judgement("reproduced", text)
    return judge(reading_percent <= LIMITED_PERCENT, text, text, correction)


def judge_light(update_ms: float, period_ms: float) -> Judgement:
    """Contribution 2: time of a map update against the time between two scans."""
    text = f"{100 * update_ms / period_ms:.2g} % of the time between two scans; light is read as at most "
    text += f"{100 * LIGHT_SHARE:g} %"
    return judge(update_ms <= LIGHT_SHARE * period_ms, text, text)


def judge_study(significant: int, factors: int) -> Judgement:
    """Contribution 3: an announced study whose results are not printed."""
    if not significant:
        return Judgement("not reproduced", f"none of {factors} factors has a significant effect")
    return Judgement("not determined by the text", f"{significant} of {factors} factors have significant effects; no "
                     "result of the paper is printed to compare with")  # fmt: skip


def judge_cells(f1: Mapping[str, float]) -> Judgement:
    """An announced study of the cell size whose results are not printed: F1 of the map by cell size."""
    apart = max(f1.values()) - min(f1.values())
    if apart <= OPEN_F1:
        return Judgement("not reproduced", f"F1 differs by at most {apart:.2g}")
    why = f"F1 differs by up to {apart:.2g}; no result of the paper is printed to compare with"
    return Judgement("not determined by the text", why)


def judge_open_choices(f1: Mapping[str, tuple[float, float]]) -> Judgement:
    """Choices that the text leaves open: lowest and highest F1 of the map over their levels."""
    if max(high for _, high in f1.values()) < WALLS_F1:
        return Judgement("not reproduced", "no reading gives a map of the place")
    matter = [name for name, (low, high) in f1.items() if high - low > OPEN_F1]
    if not matter:
        return Judgement("reproduced", "all readings give about the same map")
    return Judgement("not determined by the text", f"the map depends on {', '.join(matter)}")


def judge_slow(inside: Sequence[bool]) -> Judgement:
    """Consistent maps at low to medium speed: whether the slowest drives of each configuration stay in the limit."""
    text = f"the slowest drives stay within the limit in {sum(inside)} of {len(inside)} configurations"
    return judge(bool(inside) and all(inside), text, text)


def judge_fast(outside: Sequence[bool]) -> Judgement:
    """Fast motion is a limit: whether the fastest drives of each configuration leave the limit."""
    text = f"faster drives leave the limit in {sum(outside)} of {len(outside)} configurations"
    return judge(any(outside), text, "no drive is too fast at the speeds tried")


def judge_real_time(headroom: float) -> Judgement:
    """Real time on another device: by what factor a device may be slower than this machine."""
    if headroom < 1.0:
        return Judgement("not reproduced", "not even this machine processes every scan in time")
    return Judgement("not reproducible in software", "a device cannot be run in software; measured is by what factor "
                     "it may be slower than this machine")  # fmt: skip
