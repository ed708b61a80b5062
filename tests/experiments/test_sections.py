"""Every experiment runs with its tiny size, and any part of its results becomes a section."""

import json
from importlib import import_module

import numpy as np
import pytest
from experiments import NAMES, wand_films
from experiments.kit.render import write_section
from scipy.special import ndtr

from spheremouse.simulate.wand.film import WandOptions
from spheremouse.wand.settings import WandSettings


def rendered():
    """A result of `renderer`, which needs the shared recording: the edges are error functions."""
    at = np.arange(-2.45, 2.5, 0.1)
    edges = {name: [(2.0 * ndtr(at / s)).tolist(), [2.0] * 50] for name, s in (
        ("ours", 0.3), ("Blender", 0.4), ("Blender, linear light", 0.35))}  # fmt: skip
    rows = [[area, 9.0, 9.0, 9.01, 9.0, 0.03, 9.02, 9.0, 0.04] for area in (80.0, 20.0)]
    return {"frames": 3, "rows": rows, "geometry": [1e-4, 2e-4, 3e-3], "edges": edges}


TINY = {  # by experiment: keys of jobs, their functions and parameters
    "poses": {"far-0": ("filmed", "far", 0)},
    "surface": {"points": ("points_of_table_13",), "area": ("areas", 500)},
    "parameters": {"s1": ("compared", None, 10)},
    "filters": {"s1": ("compared", None, 30), "r1": ("play", 3.2, 1.0, False)},
    "count": {"26-0": ("with_discs", 26, 0, 20)},
    "near_far": {"far-0": ("followed", "far", 0, 0.5)},
    "light": {"s1+50": ("graded", None, 50, [15], 15)},
    "viewing": {"plain-1": ("with_film", 1, 0.4, {}), "readout-30-1": ("with_film", 1, 0.4, {"readout": 0.03})},
    "mistakes": {"lens-0.1-1": ("with_mistakes", 1, 0.6, {"lens": ([0.1], 1)}, 0.1)},
    "discs": {"size-20-0": ("of_size", 20, 0, 20), "hands-two_large-0": ("with_hands", "two large", 0, 36)},
    "targets": {"camera-0": ("filmed", 0, [4], [14, 36])},
    "places": {
        "directions-0": ("mapped", [[0, 0, 2.35, 640.0], [0, 60, 2.35, 640.0]], 1, 8, 12, 1),
    },
    "limits": {"speed-15-0": ("speeds", 15.0, 0)},
    "covers": {"cover-16-0": ("covered", 16, 0, ["closing in"]), "again-15-0": ("found_again", 15.0, 0)},
    "pointer": {"play-15-0": ("played", 15.0, 0, 4.0), "stop-30": ("stopped", 30.0, 1)},
    "wand": {"drive-01": ("film", "drive-01", True)},
}  # fmt: skip
WAND = wand_films.Film(
    "drive", "a short one", WandOptions(motion="hand", seconds=0.4, size=(320, 240)), (1,),
    tuple(wand_films.Variant(name, WandSettings(particles=20), known=True) for name in (
        "350, known start", "350, all as in the thesis")),
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_every_experiment_runs_and_renders(name, tmp_path, monkeypatch):
    monkeypatch.setattr(wand_films, "films", lambda quick: (WAND,))
    module = import_module(f"experiments.{name}")
    work = {key: (getattr(module, function), parameters) for key, (function, *parameters) in TINY.get(name, {}).items()}
    results = {key: function(*parameters) for key, (function, parameters) in work.items()} or {"far26-0": rendered()}
    results = json.loads(json.dumps(results))
    for key in results:  # an interrupted run has a section as well
        write_section(tmp_path, name, module, {key: results[key], "other": {"error": "too dark"}}, "")
    write_section(tmp_path, name, module, results, "")
    text = (tmp_path / f"{name}.md").read_text()
    assert text.startswith(f"## {module.TITLE}\n\n")
    parts = module.section(results)
    captions = [part.caption for part in parts if not part.rows.empty]
    assert captions
    assert all(caption in text for caption in captions)
    files = {path.name for path in tmp_path.iterdir()}
    linked = {link.partition(")")[0] for link in text.split("](experiments/")[1:]}
    assert linked == files - {f"{name}.md"}
