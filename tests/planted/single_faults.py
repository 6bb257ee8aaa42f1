"""The planted faults of ``single.c``, in single precision; names and list were written before any was examined."""

from __future__ import annotations

from fault import STATE, Fault

FAULTS = tuple(
    Fault(*row)
    for row in (
        (501, "distances are the larger of x and y", "neighbours|maximum distance|larger of x and y"),
        (502, "min_pairs are counted before pairs are dropped", "min_pairs|too few pairs"),
        (503, "the clouds are exchanged where the source is larger", "exchanged"),
        (504, "at most 50 iterations", "max_iterations|iteration cap"),
        (505, "exponents of parameters are not read", "epsilon|stop rule"),
        (506, "the heading is returned within a quarter turn", "heading"),
        (507, "a point without a neighbour takes that of the point before", "neighbours|one_to_one|one-to-one"),
        (508, "destroying an object frees it twice", "rule (starts|alive|memory)"),
        (509, "it stops where the pairs stay the same", "stop rule"),
        (511, "inliers are those before pairs are dropped", "inliers"),
        (512, "the error is divided by the number of source points", "error|stop rule"),
        (513, "8 bytes beyond the answer are written", "beyond its answer"),
        (514, "the texts of the parameters are read again later", "rule (bounds|starts|alive)"),
        (515, "without convergence the guess is returned", "guess is returned|converge"),
        (516, "target and source are exchanged", "exchanged"),
        (517, "of the neighbours in x only 20 are compared", "neighbours"),
        (518, "the step is that to lines", "step"),
        (519, "nothing is turned in the first two iterations", "rotation is left out"),
        (520, "a step is at most 2 cm", "step"),
        (521, "the trace ends after three iterations", "trace length"),
        (522, "iterations are summed over calls", STATE),
        (523, "floating-point exceptions are signals", "rule (floating-point|alive)"),
        (524, "the guess is written to", "wrote to the guess"),
        (525, "the means are subtracted after the products", "scales|origin|rounding|precision"),
        (526, "the moved points are moved on: harmless", ""),
        (529, "sine and cosine are short series", "rotation|heading"),
        (530, "the root is a fast one", "error|stop rule"),
        (531, "a heading beyond half a turn is wrapped by half a turn", "heading"),
        (534, "it stops by the mean squared distance", "stop rule"),
        (538, "in the first two iterations the limit is twice as large", "maximum distance"),
        (545, "without convergence it returns a code", "returned error 1"),
        (546, "the second call of an object leaves a process", "rule threads"),
    )
)
