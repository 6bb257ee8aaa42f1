"""The chapters of the paper's page, in its order."""

from __future__ import annotations

from evalkit_paper import (
    claims,
    configurations,
    equations,
    figure_10,
    flowcharts,
    maps,
    realtime,
    residuals,
    study,
    validation,
)
from evalkit_paper.chapter import Chapter

CHAPTERS: tuple[Chapter, ...] = (
    flowcharts.CHAPTER,
    validation.CHAPTER,
    equations.CHAPTER,
    configurations.CHAPTER,
    residuals.CHAPTER,
    figure_10.CHAPTER,
    study.CHAPTER,
    maps.CHAPTER,
    realtime.CHAPTER,
    claims.CHAPTER,
)
