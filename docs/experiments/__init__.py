"""The experiments of both theses, and what they left open: films made or taken, tracked, compared, written down.

A module is one experiment, what `report/` has under its name says it. In `kit/`, `job` says what an experiment is,
`run` works its jobs on all cores and keeps what they give, `film` and `world` are what most jobs are made of, `report`
and `plot` write for readers; `r1` films what the thesis' real recording was like, `detections` detects once for many
filters.
"""

NAMES = (
    "poses",
    "surface",
    "parameters",
    "filters",
    "count",
    "near_far",
    "light",
    "renderer",
    "viewing",
    "mistakes",
    "discs",
    "targets",
    "places",
    "limits",
    "pointer",
    "wand",
)  # in the report's order
