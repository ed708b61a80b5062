"""Experiments of both theses and their open questions: make or read films, track, compare, report.

Each module is one experiment. `report/` holds the template and the values of its section. `kit/` has the common parts:
`job` defines an experiment, `run` executes jobs on all cores and keeps their results, `film` and `world` make what most
jobs need, `r1` films a recording like R1 of the thesis, and `detections` detects once for several filters.
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
