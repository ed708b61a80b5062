"""An experiment that takes no time, with jobs that fail in every way; its functions are found by other processes."""

import os
import time
from pathlib import Path

from experiments.kit.job import Job
from experiments.report.page import Page, fixed, table
from experiments.report.plot import Drawing


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


PAGE = "## Squares | and more\n\nSome words.\n\n{{ table }}\n\n{{ figure('squares', 'What came.') }}\n"


def page(results):
    squares = {k: r for k, r in results.items() if k.startswith("square")}

    def draw(figure):
        axes = figure.subplots()
        axes.plot([r["n"] for r in squares.values()])
        axes.set_xlabel("job")

    rows = [(k, fixed(r["part"]["square"], 0), fixed(r.get("none"))) for k, r in squares.items()]
    return Page({"table": table(("job", "square", "none"), rows)}, (Drawing("squares", draw),))


def numbers(results):
    return {"others": results["alone"]["others"]}
