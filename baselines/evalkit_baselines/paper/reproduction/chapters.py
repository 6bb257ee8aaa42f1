"""The chapters of the paper's page, in its order."""

from __future__ import annotations

from evalkit_baselines.paper.reproduction import claims, equations, maps, realtime, study, validation
from evalkit_baselines.paper.reproduction.chapter import Chapter

CHAPTERS: tuple[Chapter, ...] = (
    validation.CHAPTER,
    equations.CHAPTER,
    study.CHAPTER,
    maps.CHAPTER,
    realtime.CHAPTER,
    claims.CHAPTER,
)
