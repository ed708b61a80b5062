"""The tables of docs/accuracy.md from runs of `spheremouse evaluate`: python docs/figures.py FAR26_DIR.

Writes docs/figures.md. Takes some minutes; simulates the rolling ball in a temporary folder.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

TRACKERS = ("ekf1", "ekf2", "so3")


def spheremouse(*arguments: str) -> None:
    """Run the command line of this interpreter's environment."""
    subprocess.run([sys.executable, "-m", "spheremouse", *arguments], check=True, stdout=subprocess.DEVNULL)


def evaluate(dataset: Path, *options: str) -> dict:
    """Return the figures of `spheremouse evaluate` for a dataset."""
    with tempfile.NamedTemporaryFile(suffix=".json") as file:
        spheremouse("evaluate", str(dataset), *options, "--json", file.name)
        return json.loads(Path(file.name).read_text())


def table(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main(far26: Path) -> str:
    """All tables."""
    runs = {(t, d): evaluate(far26, "--tracker", t, "--detector", d) for d in ("default", "blobs") for t in TRACKERS}
    known = {t: evaluate(far26, "--tracker", t, "--pose", "known") for t in TRACKERS}
    out = ["## Filter models (Wittich 2017, table 19)", ""]
    out += ["`spheremouse evaluate far26 --tracker T --detector D`, with the camera pose found from the images.", ""]
    rows = [
        ["EKF1, thesis", "0.998", "1.59", "", "", ""],
        ["EKF2, thesis", "0.999", "1.09", "0.18", "", ""],
    ]
    for (t, d), r in runs.items():
        rows.append(
            [
                f"`{t}`, `{d}`",
                f"{r['surface_speed_r']['combined']:.5f}",
                f"{r['rate_rmse_deg_s']['combined']:.2f}",
                f"{r['attitude_rmse_deg']['combined']:.3f}",
                f"{r['surface_speed_rmse_mm_s']['combined']:.1f}",
                f"{r['tracked']} / {r['lost_episodes']}",
            ]
        )
    head = ["tracker, detector", "correlation of speeds", "rate RMSE, °/s", "attitude RMSE, °", "speed RMSE, mm/s"]
    out += [table([*head, "frames tracked / times lost"], rows), ""]
    out += ["## True camera pose", ""]
    out += [
        "With `--pose known`. The bound is the posterior Cramér-Rao bound (Tichavský 1998) for the detected discs "
        "and a Gauss-Markov acceleration (Singer 1970).",
        "",
    ]
    rows = [
        [
            f"`{t}`",
            f"{r['attitude_rmse_deg']['combined']:.4f}",
            f"{r['rate_rmse_deg_s']['combined']:.3f}",
            f"{r['nees']['attitude']:.1f} / {r['nees']['rate']:.1f}",
            f"{r['bound_ratio']['attitude']:.2f} / {r['bound_ratio']['rate']:.2f}",
        ]
        for t, r in known.items()
    ]
    head = ["tracker", "attitude RMSE, °", "rate RMSE, °/s", "NEES attitude / rate (3 is right)"]
    out += [table([*head, "error over bound, attitude / rate"], rows), ""]
    pose = runs["so3", "default"]["pose_error"]
    out += [
        "## Camera pose",
        "",
        "One estimate from four targets, with the standard deviations that it states. Table 21 of the thesis has 0.6, "
        "2.9 and 0.0 mm.",
        "",
    ]
    rows = [
        [
            "position, mm",
            *(f"{e:+.2f} ± {s:.2f}" for e, s in zip(pose["position_mm"], pose["sigma_position_mm"], strict=True)),
        ],
        [
            "rotation, °",
            *(f"{e:+.4f} ± {s:.3f}" for e, s in zip(pose["angle_deg"], pose["sigma_angle_deg"], strict=True)),
        ],
    ]
    out += [table(["error ± standard deviation", "x", "y", "z"], rows), ""]
    out += ["## Detection", "", "Against `discs.csv`, for wholly visible discs of at least 12 px².", ""]
    rows = []
    for d in ("default", "blobs"):
        r = runs["so3", d]["detection"]
        rows.append(
            [
                f"`{d}`",
                f"{100 * r['recall']:.1f} ({100 * r['recall_15']:.1f})",
                f"{100 * r['false_share']:.2f}",
                f"{r['centre_rms_px']:.3f} ({r['centre_rms_60_px']:.3f})",
            ]
        )
    head = [
        "detector",
        "recall, % (≥ 15 px²)",
        "false points used, %",
        "centre RMS per axis, px (≥ 60 px²)",
    ]
    out += [table(head, rows), ""]
    out += ["## A ball that rolls on", ""]
    out += ["`spheremouse simulate roll --motion roll --turns 20` and `spheremouse evaluate roll --tracker T`.", ""]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        spheremouse("simulate", f"{folder}/roll", "--motion", "roll", "--turns", "20")
        for t in TRACKERS:
            r = evaluate(Path(folder) / "roll", "--tracker", t)
            rows.append(
                [
                    f"`{t}`",
                    f"{r['attitude_rmse_deg']['combined']:.3f}",
                    f"{r['rate_rmse_deg_s']['combined']:.2f}",
                    f"{r['tracked']} of {r['frames']}",
                    str(r["lost_episodes"]),
                ]
            )
    out += [table(["tracker", "attitude RMSE, °", "rate RMSE, °/s", "tracked", "times lost"], rows), ""]
    return "\n".join(out)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    text = main(Path(sys.argv[1]))
    target = Path(__file__).with_name("figures.md")
    temporary = target.with_suffix(".tmp")
    temporary.write_text("% made by docs/figures.py\n\n" + text, encoding="utf-8")
    temporary.rename(target)
