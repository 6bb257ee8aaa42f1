"""The chapters of the paper's page, in its order."""

from __future__ import annotations

from evalkit_paper import (
    claims_chapter,
    equation_chapter,
    figure_10_chapter,
    flowchart_chapter,
    realtime_chapter,
    residual_chapter,
    stage_configurations,
    study_chapter,
    validation_chapter,
)
from evalkit_paper.chapter import Chapter

CHAPTERS: tuple[Chapter, ...] = (
    flowchart_chapter.CHAPTER,
    validation_chapter.CHAPTER,
    equation_chapter.CHAPTER,
    stage_configurations.CHAPTER,
    residual_chapter.CHAPTER,
    figure_10_chapter.CHAPTER,
    study_chapter.CHAPTER,
    study_chapter.MAP_CHAPTER,
    realtime_chapter.CHAPTER,
    claims_chapter.CHAPTER,
)
