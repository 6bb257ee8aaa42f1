"""The planted faults of all sources, and the builds of the correct ones; here those of ``planted.c``."""

from __future__ import annotations

import odometry_faults
import program_faults
import second_faults
import single_faults
from fault import Fault

FAULTS = tuple(
    Fault(*row)
    for row in (
        (1, "a call leaks 16 bytes", "rule memory"),
        (2, "a call with too few pairs leaks", "rule memory"),
        (3, "an instance leaks", "rule memory"),
        (4, "a call leaves a file open", "rule open-files"),
        (5, "every 50th call leaves a thread", "rule threads"),
        (6, "a call costs more than the one before", "rule slowdown"),
        (7, "the rounding mode is changed", "rule floating-point"),
        (8, "small numbers are flushed to zero afterwards", "rule floating-point"),
        (9, "a signal handler is installed", "rule signals"),
        (10, "a signal is blocked", "rule signals"),
        (11, "the locale is changed", "rule locale"),
        (12, "the working folder is changed", "rule folder"),
        (13, "an environment variable is set", "rule folder"),
        (14, "the target is cached by its address", "rule buffers"),
        (15, "the pointer of the call before is read", "rule bounds"),
        (16, "the start is drawn towards the answer before", "rule (stateless|call-order)"),
        (17, "all instances share the settings of the last one", "rule instances"),
        (18, "only the first thread has its scratch memory", "rule thread"),
        (19, "the answer depends on the second of the clock", "rule later"),
        (20, "the answer depends on the process number", "rule process"),
        (21, "weights are read before they are written", "rule (process|deterministic|call-order)"),
        (22, "the source is written to and restored", "rule (bounds|read-only)"),
        (23, "one number beyond the source is read", "rule bounds"),
        (24, "after 1,000 calls the answer changes", "rule many-calls"),
        (25, "only 4,096 target points are used", "rule large|sizes"),
        (26, "targets are counted with 16 bits", "rule large|sizes"),
        (27, "more than 65,535 source points crash", "rule (large|alive)"),
        (28, "points at zero are invalid", "points.*zero"),
        (29, "a neighbour across zero is not found", "neighbours"),
        (30, "the heading of the guess is limited", "start|headings|heading of the guess"),
        (31, "the heading is linearised", "rule|rotation|headings"),
        (32, "points beyond 100 m are dropped", "scales|rule converged"),
        (34, "repeated source points are dropped", "twice|duplicates"),
        (35, "collinear points are not turned", "collinear|rotation is left out"),
        (36, "the last source point is not used", "last source point|sizes|bounds"),
        (37, "the first target point is not used", "first target point|sizes"),
        (38, "max_correspondence_m is ignored", "max_correspondence_m has no effect"),
        (39, "min_pairs is ignored", "min_pairs has no effect"),
        (40, "epsilon is ignored", "epsilon has no effect"),
        (41, "one iteration more than max_iterations", "max_iterations|iteration cap"),
        (42, "one_to_one is ignored", "one_to_one has no effect"),
        (43, "epsilon is read as a whole number", "stop rule"),
        (44, "max_correspondence_m = 0 keeps nothing", "max_correspondence_m = 0"),
        (45, "the squared distance is compared with the limit", "maximum distance"),
        (46, "the limit is 1 % too large", "maximum distance|max_correspondence_m"),
        (47, "at the last iteration it never converged", "converged"),
        (48, "it has always converged", "converged"),
        (49, "min_pairs are too few", "with a partner|min_pairs|number of pairs is"),
        (51, "the error before the first iteration is 0", "stop rule|converged|guess is the answer"),
        (52, "with too few pairs the pose so far is returned", "too few pairs"),
        (53, "inliers are those of the iteration before", "inliers"),
        (54, "inliers counts every source point", "inliers"),
        (55, "the error is the root mean square", "root mean square"),
        (56, "the error is that before the step", "before the step"),
        (57, "the iterations are counted from 0", "iterations"),
        (58, "the trace has the pose before the step", "trace pose"),
        (59, "the trace lacks the last iteration", "trace length"),
        (60, "the trace has the error before the step", "trace error"),
        (61, "the pose before the last step is returned", "last step"),
        (62, "the rotation is transposed", "transposed"),
        (63, "several sources may have one target", "one-to-one"),
        (64, "the first pairs are kept", "stale pairs"),
        (65, "the second nearest neighbour is taken", "second nearest"),
        (66, "it stops by the size of the step", "stop rule"),
        (67, "epsilon is relative", "stop rule"),
        (68, "half of each step is made", "step.*half|0.5 times"),
        (69, "the step is composed on the wrong side", "wrong side"),
        (70, "the centroid is that of all points", "centroid"),
        (71, "the translation leaves out the rotation", "leaves out the rotation"),
        (72, "x and y are exchanged", "x and y exchanged"),
        (73, "the angle is in degrees", "degrees"),
        (74, "the answer is in millimetres", "millimetres|1000 times"),
        (75, "the answer is the inverse", "inverse|rule direction"),
        (76, "the guess is not used", "guess is not used"),
        (77, "near pairs weigh more", "step.*weigh"),
        (78, "the longest tenth of the pairs is dropped", "outlier rule.*longest"),
        (79, "pairs beyond three medians are dropped", "outlier rule.*longest"),
        (80, "of several sources the first is kept, not the closest", "one-to-one.*first"),
        (81, "the angle is computed by a quotient", "step"),
        (82, "neighbours are nearest by the sum of x and y", "neighbours"),
        (83, "one iteration fewer than max_iterations", "max_iterations|iteration cap"),
        (84, "an empty source crashes", "rule empty"),
        (85, "without a pair it never returns", "rule in-time"),
        (86, "one point gives nan", "rule few-points"),
        (87, "neighbours come from the point's own cell", "neighbours"),
        (88, "nothing is ever turned", "rotation is left out"),
        (89, "the step is inverted", "step is inverted"),
        (90, "it stops where the error is small", "stop rule"),
        (91, "the guess is inverted", "guess is inverted"),
        (92, "the heading of the guess is taken for degrees", "degrees"),
        (93, "the answer depends on the process number, slightly", "rule (process|deterministic|later)"),
        (94, "every other iteration pairs twice: harmless", ""),
        (95, "the trace has the pairs of the iteration before", "trace inliers"),
        (96, "with too few pairs inliers is 0", "inliers"),
        (97, "with too few pairs it has converged", "converged"),
        (98, "the error is in millimetres", "1000 times|error"),
        (99, "the error is missing where it did not converge", "error"),
        (50, "a tie between sources goes to the higher index: harmless", ""),
    )
)

LIBRARIES = {
    "planted.c": FAULTS,
    "second.cpp": second_faults.FAULTS,
    "single.c": single_faults.FAULTS,
    "program.rs": program_faults.FAULTS,
    "odometry.c": odometry_faults.FAULTS,
}
"""The faults of each source."""

C_BUILDS = ("-O0", "-O1", "-O3", "-O3 -ffast-math", "-Os", "-O2", "-O2 -DSINGLE", "-O3 -DSINGLE -ffast-math")
BUILDS = {".c": C_BUILDS, ".cpp": C_BUILDS, ".rs": ("-C opt-level=0", "-O", "-C opt-level=3")}
"""Correct builds, none of which may fail, with every compiler that is installed."""

FAULT_BUILDS = {"single.c": "-O2 -DSINGLE"}
"""How the faults of a source are built, where not as the second correct build."""
