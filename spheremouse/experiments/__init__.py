"""The experiments of both theses, and what they left open: films made or taken, tracked, compared, written down.

`experiment` says what an experiment is, `run` works its jobs on all cores and keeps what they give, `kit` is what most
jobs are made of, `report` and `plot` write for readers. Each other module is one experiment.
"""

NAMES = ()
