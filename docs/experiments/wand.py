"""The hand-held ball: accuracy, runs that lose it, start without a pose, speed (Grzonka 2005, chapter 4)."""

from pathlib import Path

from experiments import wand_films as wand
from experiments.kit.job import Job, Request, Result

SPEEDS = "speeds"


def jobs(request: Request) -> list[Job]:
    """Each film with each seed, and the speeds."""
    films = [
        Job(job.key, film, {"key": job.key, "quick": request.quick}, cost=_cost(job.film))
        for job in wand.jobs(request.quick)
    ]
    if request.datasets is not None:
        path, shared = str(request.datasets / wand.RECORDING), wand.recording_film(request.quick)
        for k, variant in enumerate(shared.variants):
            what = {"path": path, "quick": request.quick, "variant": k}
            films.append(Job(wand.recording_key(variant), recorded, what, cost=6.0 * len(shared.seeds)))
    return [*films, Job(SPEEDS, speeds, {"frames": 20 if request.quick else 60}, cost=25.0, alone=True)]


def _cost(film: wand.Film) -> float:
    """s of one core, about: drives have a tenth of the frames of hand-held films, and most are small pictures."""
    if film.name == "drive":
        return 2.0 * len(film.variants)
    return sum(6.0 * v.settings.particles / 5000 for v in film.variants) if film.name == "drive-many" else 16.0


def film(key: str, quick: bool) -> Result:
    """Results of the trackers on one film."""
    (job,) = [job for job in wand.jobs(quick) if job.key == key]
    return wand.work(job)


def recorded(path: str, quick: bool, variant: int) -> Result:
    """Results of a tracker on the shared recording, by seed."""
    film = wand.recording_film(quick)
    return wand.work_recording(Path(path), film.variants[variant], film.seeds)


def speeds(frames: int) -> Result:
    """Frames per second, over so many frames."""
    return wand.measure_speeds(frames)
