"""What the drives teach: the bins of the calibration, and how they hold in each world when learnt on the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from evalkit.commands.map_fit.drives import MeasuredScans
from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats
from evalkit.metrics.fit_calibration import LIMITS_M, SCHEMA, WRONG_M, FitCalibration, find_bins, learn_bins
from evalkit.stats.paired_tests import vargha_delaney_a12

GROUPS = (0.0, 0.02, 0.1, 0.5, 0.9, 1.0)
"""Limits of the probabilities between which the predicted share of wrong positions is compared with the true one."""

MISFIT_M = 1e3
"""Stands for the predicted error of a scan that does not fit, where scans are ranked by it."""


@dataclass(frozen=True)
class Drive:
    """The measured scans of one drive: in which world, with which tracker and which fault."""

    world: str
    method: str
    fault: str
    scans: MeasuredScans


@dataclass(frozen=True, eq=False)
class Scans:
    """The scans of many drives, each array (N,). ``wrong``: whether the position is more than ``WRONG_M`` off."""

    world: np.ndarray
    fault: np.ndarray
    fit_m: Floats
    points: np.ndarray
    cell_m: Floats
    wrong: Bools

    @classmethod
    def of(cls, drives: Sequence[Drive]) -> Scans:
        """Return the scans of drives in one row."""
        counts = [len(drive.scans["fit_m"]) for drive in drives]

        def repeat(values: Sequence[Any]) -> np.ndarray:
            return np.repeat(np.array(values), counts)

        return cls(
            repeat([drive.world for drive in drives]),
            repeat([drive.fault for drive in drives]),
            np.concatenate([drive.scans["fit_m"] for drive in drives]),
            np.concatenate([drive.scans["points"] for drive in drives]),
            repeat([drive.scans["cell_m"] for drive in drives]),
            np.concatenate([drive.scans["error_m"] for drive in drives]) > WRONG_M,
        )

    def select(self, chosen: Bools) -> Scans:
        """Return some of the scans."""
        return Scans(
            self.world[chosen], self.fault[chosen], self.fit_m[chosen], self.points[chosen], self.cell_m[chosen],
            self.wrong[chosen],
        )  # fmt: skip

    @cached_property
    def calibration(self) -> FitCalibration:
        """What these scans teach; nothing is checked."""
        probabilities, misfit = learn_bins(self.fit_m, self.wrong)
        cells = float(self.cell_m.min()), float(self.cell_m.max())
        return FitCalibration(
            probabilities, misfit, cells, int(self.points.min()), tuple(dict.fromkeys(self.world.tolist())), {}
        )


def summarize(drives: Sequence[Drive]) -> dict[str, Any]:
    """Return the measured keys of ``fit_calibration.json``."""
    scans = Scans.of(drives)
    learnt, predicted = scans.calibration, predict_from_others(scans)
    bins, fits = find_bins(scans.fit_m), np.isfinite(scans.fit_m)
    rows = [
        {"below_m": limit, **_count(scans.wrong[fits & (bins == number)]), "probability": learnt.probabilities[number]}
        for number, limit in enumerate((*LIMITS_M, None))
    ]
    names = {"world": scans.world, "fault": scans.fault}
    return {
        "schema": SCHEMA,
        "wrong_m": WRONG_M,
        "worlds": list(learnt.worlds),
        "methods": list(dict.fromkeys(drive.method for drive in drives)),
        "drives": len(drives),
        "drives_without_scans": sum(not len(drive.scans["fit_m"]) for drive in drives),
        "cells_m": list(learnt.cells_m),
        "min_points": learnt.min_points,
        "bins": rows,
        "misfit": {**_count(scans.wrong[~fits]), "probability": learnt.misfit},
        "check": {
            **_check(scans, predicted, np.ones_like(scans.wrong)),
            "reliability": compare_shares(predicted, scans.wrong),
            **{
                f"by_{kind}": {one: _check(scans, predicted, own == one) for one in dict.fromkeys(own.tolist())}
                for kind, own in names.items()
            },
        },
    }


def predict_from_others(scans: Scans) -> Floats:
    """Return the probability (N,) of a wrong position of each scan by what all other worlds teach.

    nan where a scan is outside the range of those.
    """
    predicted = np.full(len(scans.wrong), np.nan)
    for world in np.unique(scans.world):
        own = scans.world == world
        others = scans.select(~own).calibration
        for cell_m in np.unique(scans.cell_m[own]).tolist():
            rows = own & (scans.cell_m == cell_m)
            predicted[rows] = others.predict(scans.fit_m[rows], scans.points[rows], cell_m)
    return predicted


def compare_shares(predicted: Floats, wrong: Bools) -> list[dict[str, Any]]:
    """Return a row for each group of probabilities between ``GROUPS``: scans, mean probability, share that is wrong."""
    group = np.clip(np.searchsorted(GROUPS, predicted, side="right") - 1, 0, len(GROUPS) - 2)
    rows = []
    for number in range(len(GROUPS) - 1):
        own = np.isfinite(predicted) & (group == number)
        if own.any():
            mean = float(predicted[own].mean())
            rows.append({"from": GROUPS[number], "to": GROUPS[number + 1], **_count(wrong[own]), "predicted": mean})
    return rows


def _count(wrong: Bools) -> dict[str, Any]:
    return {"scans": len(wrong), "wrong_share": float(wrong.mean()) if len(wrong) else None}


def _check(scans: Scans, predicted: Floats, chosen: Bools) -> dict[str, Any]:
    """Return how well the probabilities of some scans hold.

    ``auc``: the probability that the fit ranks a wrong position behind a right one, None where there are not both.
    ``brier``: mean squared difference of the probability and what is true (0 or 1); ``brier_constant``: if the
    probability were always the share of wrong positions.
    """
    own = chosen & np.isfinite(predicted)
    wrong, fit_m = scans.wrong[own], np.nan_to_num(scans.fit_m[own], nan=MISFIT_M)
    both = len(wrong) and 0 < wrong.sum() < len(wrong)
    share = float(wrong.mean()) if len(wrong) else None
    return {
        **_count(wrong),
        "outside_range": int((chosen & np.isnan(predicted)).sum()),
        "predicted": float(predicted[own].mean()) if len(wrong) else None,
        "auc": vargha_delaney_a12(fit_m[wrong], fit_m[~wrong]) if both else None,
        "brier": float(np.mean((predicted[own] - wrong) ** 2)) if len(wrong) else None,
        "brier_constant": None if share is None else share * (1.0 - share),
    }


def format_markdown(content: Mapping[str, Any]) -> str:
    """Return the bins and their check as Markdown tables."""
    check = content["check"]
    bins = [
        (f"below {one['below_m']:g} m" if one["below_m"] else f"{LIMITS_M[-1]:g} m and more", one)
        for one in content["bins"]
    ]
    shares = [(f"{100 * row['from']:g} to {100 * row['to']:g} %", row) for row in check["reliability"]]
    kinds = [("all", check), *check["by_world"].items(), *check["by_fault"].items()]
    return "\n".join(
        [
            "| fit | scans | wrong | probability |",
            "|--|--:|--:|--:|",
            *(
                f"| {name} | {one['scans']:,} | {_percent(one['wrong_share'])} | {_percent(one['probability'])} |"
                for name, one in (*bins, ("no prediction", content["misfit"]))
            ),
            "",
            "| probability | scans | predicted | wrong |",
            "|--|--:|--:|--:|",
            *(
                f"| {name} | {row['scans']:,} | {_percent(row['predicted'])} | {_percent(row['wrong_share'])} |"
                for name, row in shares
            ),
            "",
            "| | scans | outside | predicted | wrong | AUC | Brier | of a constant |",
            "|--|--:|--:|--:|--:|--:|--:|--:|",
            *(
                f"| {name} | {row['scans']:,} | {row['outside_range']:,} | {_percent(row['predicted'])} | "
                f"{_percent(row['wrong_share'])} | {_number(row['auc'])} | {_number(row['brier'])} | "
                f"{_number(row['brier_constant'])} |"
                for name, row in kinds
            ),
            "",
        ]
    )


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
