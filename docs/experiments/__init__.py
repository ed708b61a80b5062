"""Experiments of both theses and their open questions: make or read films, track, compare, report.

Each module is one experiment: its parameters, its `jobs`, and the `section` of the page that follows from their
results. Its docstring is the introduction of that section. Kept results stay valid if only
lines below `# ---- section ----` change. `kit/` has the common parts: `job` defines an experiment,
`run` executes jobs on all cores and keeps their results, `render` writes tables and plots, `film` and `world` make what
most jobs need, `r1` films a recording like R1 of the thesis, and `detections` detects once for several filters.
"""

NAMES = (  # in the report's order
    "poses", "surface", "parameters", "filters", "count", "near_far", "light", "renderer", "viewing", "mistakes",
    "discs", "targets", "places", "limits", "covers", "pointer", "wand"
)  # fmt: skip
