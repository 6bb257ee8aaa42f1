"""The sentences of the page, computed from the analysis: start here to change or add one.

``title``: the title and the lines below it. ``pills``: short warnings beside it. ``overview``: all sequences in a few
sentences. ``verdict``: one sequence. ``warnings``: the limits of a verdict. Each sentence has a check in
``tests/claims/``, which recomputes its numbers from the runs.
"""
