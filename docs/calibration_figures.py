"""The figures of docs/calibration.md: python docs/calibration_figures.py DATASETS [--runs N] [--write] [--keep FOLDER].

DATASETS holds `stills` and `far26`. Every figure comes from a command as a person would type it, and is compared with
the truth here. `--write` replaces the table of the page. Takes about five minutes.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from experiments.kit.observations import calibrated, normalised_errors, simulated_calibration
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from spheremouse.files.safe_files import write_atomically
from spheremouse.geometry.rotation import log

PAGE = Path(__file__).with_name("calibration.md")
MARKS = ("<!-- made by docs/calibration_figures.py --write -->", "<!-- end -->")
Row = tuple[str, str, str, str]  # what, command, figure, asked
NINE = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
FREEDOM = {"ball": 4, "targets": 9, "poses": 6}


def spheremouse(*words: object) -> str:
    """Return the output of a command. Its error ends the script."""
    done = subprocess.run(
        [sys.executable, "-m", "spheremouse", *map(str, words)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        sys.exit(f"spheremouse {' '.join(map(str, words))}: {done.stderr.strip()}")
    return done.stdout


def figures(*words: object, file: Path) -> Any:
    """The JSON that a command writes."""
    spheremouse(*words, "--json", file)
    return json.loads(file.read_text())


def stills(folder: Path, work: Path) -> list[Row]:
    """Camera and device from the shared photos."""
    truth = json.loads((folder / "truth.json").read_text())
    camera_file, rig_file = work / "camera.yaml", work / "rig.yaml"
    board = ("calibrate", "camera", folder / "board", "--board", "11x8", "--square", "86mm", "--out", camera_file)
    camera = figures(*board, file=work / "camera.json")
    device_words = ("calibrate", "device", folder / "device", "--device", folder / "device.yaml")
    device = figures(*device_words, "--camera", camera_file, "--out", rig_file, file=work / "device.json")
    return [*camera_rows(camera, truth), *device_rows(device, truth)]


def named(camera: Any) -> dict[str, float]:
    """The nine parameters."""
    return {**{k: camera[k] for k in NINE[:4]}, **dict(zip(NINE[4:], camera["dist"], strict=True))}


def camera_rows(found: Any, truth: Any) -> list[Row]:
    values, true = (named(c["camera"]) for c in (found, truth))
    sigma = found["camera"]["sigma"]
    sigma = sigma if isinstance(sigma, dict) else dict(zip(true, sigma, strict=True))
    worst = max(abs(values[k] - true[k]) / sigma[k] for k in true)
    focal = max(abs(values[k] / true[k] - 1.0) for k in ("fx", "fy"))
    middle = max(abs(values[k] - true[k]) for k in ("cx", "cy"))
    what = "camera, `stills`"
    return [
        ("focal lengths", what, f"{100 * focal:.3f} %", "0.05 %"),
        ("principal point", what, f"{middle:.2f} px", "0.5 px"),
        ("reprojection RMSE", what, f"{found['rms_px']:.3f} px", "0.09 px"),
        ("largest error over sigma", what, f"{worst:.1f}", "3.5"),
    ]


def device_rows(found: Any, truth: Any, what: str = "device, `stills`") -> list[Row]:
    """Errors of targets, ball and discs in mm, and in standard deviations."""
    targets = {t["id"]: np.array(t["position"]) for t in truth["targets"]}
    radius = truth["ball"]["radius"]
    discs = np.array(truth["discs_obj"])
    off = {"targets": [], "discs": []}
    over: list[float] = []
    for t in found["targets"]:
        e = np.array(t["position"]) - targets[t["id"]]
        off["targets"].append(np.linalg.norm(e))
        over += list(np.abs(e) / np.array(t["sigma"]))
    for d in found["discs"]:
        e = discs - np.array(d["position"])
        e = e[np.argmin(np.linalg.norm(e, axis=1))]
        off["discs"].append(np.linalg.norm(e))
        over += list(np.abs(e) / np.array(d["sigma"]))
    # the frame of the bundle has its origin in the target that the device file says
    origin = min(targets.values(), key=lambda p: np.linalg.norm(p + np.array(found["ball"]["center"])))
    centre = np.array(found["ball"]["center"]) + origin
    sigma = found["ball"]["sigma"]
    ball = np.array([*centre, found["ball"]["radius"] - radius])
    over += list(np.abs(ball) / np.array([sigma[k] for k in "XYZR"]))
    for photo in found["photos"]:
        true = np.array(truth["device_poses"][Path(photo["file"]).stem])
        T = np.array(photo["T_obj_cam"])
        e = np.concatenate([T[:3, 3] - true[:3, 3], log(T[:3, :3] @ true[:3, :3].T)])
        over += list(np.abs(e) / np.array(photo["sigma"]))
    return [
        ("targets, at most", what, f"{1e3 * max(off['targets']):.2f} mm", "1 mm"),
        ("ball's centre", what, f"{1e3 * np.linalg.norm(centre):.2f} mm", "3 mm"),
        ("radius", what, f"{1e3 * ball[3]:+.2f} mm, sigma {1e3 * sigma['R']:.2f} mm", "3 mm"),
        (
            "discs, RMS",
            what,
            f"{1e3 * np.sqrt(np.mean(np.square(off['discs']))):.2f} mm ({len(found['discs'])})",
            "1.5 mm",
        ),
        ("largest error over sigma", what, f"{max(over):.1f}", "3.5"),
    ]


def covariances(runs: int) -> list[Row]:
    """ANEES of simulated calibrations."""
    errors: dict[str, list[float]] = {name: [] for name in FREEDOM}
    for seed in range(runs):
        simulated = simulated_calibration(np.random.default_rng(seed))
        for name, value in normalised_errors(simulated, calibrated(simulated)).items():
            errors[name].append(value)
    rows = []
    for name, freedom in FREEDOM.items():
        low, high = chi2.ppf([0.025, 0.975], freedom * runs) / (freedom * runs)
        figure = f"{np.mean(errors[name]):.3f}"
        rows.append((f"ANEES of {name}", f"{runs} simulations", figure, f"{low:.3f} to {high:.3f}"))
    return rows


def tracked(far26: Path, work: Path) -> list[Row]:
    """Return the errors of tracking far26 with a rig from simulated photos, or from rolling."""
    evening, rig_file, roll_file = work / "evening", work / "far26.yaml", work / "roll.yaml"
    spheremouse("calibrate", "practice", evening, "--like", far26, "--no-film")
    camera_file = work / "evening-camera.yaml"
    board = ("calibrate", "camera", evening / "board", "--board", "11x8", "--square", "86mm", "--out", camera_file)
    figures(*board, file=work / "evening-camera.json")
    words = ("calibrate", "device", evening / "device", "--device", evening / "device.yaml", "--camera", camera_file)
    found = figures(*words, "--out", rig_file, file=work / "evening.json")
    truth = json.loads((evening / "truth.json").read_text())
    rows = device_rows(found, truth, "device, `far26`")
    rolled = figures(
        "calibrate", "rolling", "--source", f"dataset:{far26}", "--out", roll_file, file=work / "roll.json"
    )
    scene = json.loads((far26 / "scene.json").read_text())
    true = np.array(scene["truth_T_obj_cam"])
    ratio = np.linalg.norm(true[:3, 3]) / scene["ball"]["radius"]
    towards = -true[:3, :3].T @ true[:3, 3]
    towards /= np.linalg.norm(towards)
    angle = np.degrees(np.arccos(np.clip(towards @ np.array(rolled["center_direction"]), -1.0, 1.0)))
    what = "rolling, `far26`"
    rows += [
        ("radius over distance", what, f"{100 * abs(ratio / rolled['ratio'] - 1.0):.4f} %", "0.1 %"),
        ("centre direction", what, f"{angle:.4f}°", "0.02°"),
    ]
    across_rows = len(rows)
    lens = work / "far26-camera.yaml"
    c = scene["camera"]
    lens.write_text(
        f"schema: 1\ncamera: {{width: {scene['width']}, height: {scene['height']}, fx: {c['fx']}, fy: {c['fy']}, "
        f"cx: {c['cx']}, cy: {c['cy']}, dist: {c['dist']}}}\n"
    )
    right = figures("evaluate", far26, file=work / "true.json")
    for name, options, limit in (
        ("photos", ("--rig", rig_file, "--camera", lens), "1.2"),
        ("rolling", ("--rig", roll_file), "1.3"),
    ):
        result = figures("evaluate", far26, *options, file=work / f"{name}.json")
        ratios = [result[key]["combined"] / right[key]["combined"] for key in ("attitude_rmse_deg", "rate_rmse_deg_s")]
        if name == "photos":  # the same two by photos, the pose found from the targets
            position = true[:3, 3] + 1e-3 * np.array(result["pose_error"]["position_mm"])
            R = np.array(Rotation.from_rotvec(np.radians(result["pose_error"]["angle_deg"])).as_matrix())
            seen = -(R @ true[:3, :3]).T @ position
            angle = np.degrees(np.arccos(np.clip(towards @ seen / np.linalg.norm(seen), -1.0, 1.0)))
            photo_ratio = np.linalg.norm(position) / found["ball"]["radius"]
            what = "device, `far26`"
            rows[across_rows:across_rows] = [
                ("radius over distance", what, f"{100 * abs(ratio / photo_ratio - 1.0):.4f} %", "as by rolling"),
                ("centre direction", what, f"{angle:.4f}°", "as by rolling"),
            ]
        figure = f"{ratios[0]:.2f} / {ratios[1]:.2f}"
        what = f"{'device' if name == 'photos' else name}, `far26`"
        rows.append(("attitude, rate over true rig's", what, figure, limit))
    return rows


def main() -> None:
    """Parse, run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("datasets", type=Path)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--keep", type=Path, help="folder for what the commands write")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        work = args.keep or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        rows = [
            *stills(args.datasets / "stills", work),
            *tracked(args.datasets / "far26", work),
            *covariances(args.runs),
        ]
    head = [("error", "calibration", "figure", "limit"), ("---", "---", "---", "---")]
    text = "\n".join("| " + " | ".join(row) + " |" for row in [*head, *rows])
    print(text)
    if args.write:
        before, _, rest = PAGE.read_text(encoding="utf-8").partition(MARKS[0])
        write_atomically(PAGE, f"{before}{MARKS[0]}\n\n{text}\n\n{MARKS[1]}{rest.partition(MARKS[1])[2]}")


if __name__ == "__main__":
    main()
