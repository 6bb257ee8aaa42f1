"""The planted faults of ``program.rs``; names and list were written before any of them was examined."""

from __future__ import annotations

from fault import STATE, Fault

FAULTS = tuple(
    Fault(*row)
    for row in (
        (301, "numbers are written with six decimals", "precision|round|decimals|digits"),
        (302, "answers are not flushed", "(rule (starts|in-time|alive)|cannot be checked).*no answer"),
        (303, "a line is cut after 64 KiB", "rule large|sizes"),
        (304, "the order of a sum is that of a hash table", STATE),
        (305, "inliers are counted with 8 bits", "inliers"),
        (306, "cells are numbered towards zero, and cell 0 is wider: harmless", ""),
        (307, "it stops where the error rises", "stop rule"),
        (308, "an empty target ends the program", "rule (empty|alive)"),
        (309, "every 50th call leaves a thread", "rule threads"),
        (310, "a call leaks 4 KiB", "rule memory"),
        (311, "the target is kept while its size is the same", STATE),
        (312, "the guess is read as theta, x, y", "guess|start"),
        (313, "the pose is written as theta, x, y", "order|theta|rule (metres|radians)"),
        (316, "the error is missing where it did not converge", "error"),
        (318, "a message is written to the standard output", "without a question|message|not one line"),
        (319, "numbers with an exponent are read without it", "small|exponent|zero|scales|points"),
    )
)
