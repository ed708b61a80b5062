"""An experiment that takes no time, with jobs that fail in every way; its functions are found by other processes."""

import os
import time
from pathlib import Path

import numpy as np
import pandas as pd
from experiments.kit.job import Job
from experiments.kit.render import Plot, Table


def square(n, made):
    Path(made, f"{n}-{time.monotonic_ns()}").touch()
    if n == 3:
        raise ValueError("three\nis too many")
    return {"n": n, "part": {"square": n * n}}


def die():
    os._exit(1)


def last(made):
    Path(made, str(os.getpid())).touch()
    time.sleep(120.0)


def alone(made):
    return {"others": len(list(Path(made).iterdir()))}


def jobs(request):
    made = os.environ["TINY_MADE"]
    most = 3 if request.quick else 4
    return [
        Job("alone", alone, {"made": made}, alone=True),
        *(Job(f"square-{n}", square, {"n": n, "made": made}, cost=n) for n in range(most)),
    ]


TITLE = "Squares | and more"


def section(results):
    squares = [{"job": k, "n": r["n"], "square": r["part"]["square"]} for k, r in results.items() if "part" in r]
    rows = pd.DataFrame(squares, columns=["job", "n", "square"])
    table = Table("What came", rows.drop(columns="n").assign(none=np.nan))
    plot = Plot("squares", "What came.", rows, "n", ["square"], "job")
    others = Table("Other workers", pd.DataFrame({"others": [results["alone"]["others"]]}))
    return [others, table, plot]
