"""The status of a live run, collected from its parts. Any thread may collect it."""

import os
import time
from pathlib import Path

from spheremouse import __version__
from spheremouse.capture.replay import Replay
from spheremouse.output.reporter import ReporterStatus
from spheremouse.output.third_axis import left_out
from spheremouse.session.config_reloader import given
from spheremouse.session.control.status import (
    CameraStatus,
    OutputStatus,
    Quantiles,
    ReplayStatus,
    SourceStatus,
    State,
    StatusReport,
)
from spheremouse.session.live_run import LiveRun
from spheremouse.session.record.places import recordings_folder
from spheremouse.session.run_config import RunConfig
from spheremouse.session.timing import memory_mb


def status_of(run: LiveRun) -> StatusReport:
    """Return the status of a run."""
    now = time.monotonic()
    worker, captures, monitor = run.worker, run.captures, run.monitor
    plan, overrides = run.reloader.plan, run.reloader.overrides
    outputs = [_output_status(spec, status) for spec, status in run.outputs.status()]
    return StatusReport(
        **dict(run.adapter.tracker_status(monitor.state not in (State.STARTING, State.NO_CAMERA))),
        state=str(monitor.state),
        reason=monitor.reason,
        since_s=now - monitor.since,
        fps=run.arrivals.rate(now),
        latency_ms=outputs[0].latency_ms,
        stages_ms={name: _ms(*quantiles) for name, quantiles in worker.stages.items()},
        tracker=plan.configuration.tracker,
        frames=worker.frames,
        skipped=run.ring.skipped,
        dropped=captures.dropped,
        damaged=worker.damaged,
        counts=list(run.outputs.counts),
        outputs=outputs,
        source=_source_status(plan, captures.first.description, run.setup.replay),
        cameras=_cameras_status(run),
        unseen_s=monitor.unseen,
        lost_count=worker.lost,
        camera_restarts=captures.restarts,
        uptime_s=now - run.began,
        version=__version__,
        pid=os.getpid(),
        config=_absolute(overrides.file),
        changes=list(overrides.changes),
        given=list(given(overrides)),
        saved=None if overrides.saved is None else list(plan.saved),
        rig=_absolute(plan.rig_path),
        map=_absolute(plan.map_path),
        recording=run.archive.status(),
        recordings=str(recordings_folder(plan.configuration.record)),
        memory_mb=memory_mb(),
        cpu_share=run.cpu.share,
        scheduling=run.scheduling,
        paused=bool(monitor.paused),
    )


def _cameras_status(run: LiveRun) -> list[CameraStatus]:
    """Return the status of each camera if there are two; else it is that of the run."""
    plans = run.reloader.plan.cameras
    if len(plans) == 1:
        return []
    return [
        CameraStatus(
            spec=plan.source,
            description=run.captures.each[k].description,
            trouble=run.trouble_of(k),
            rig=_absolute(plan.rig_path),
            frames=run.worker.frames_of[k],
            restarts=run.captures.each[k].restarts,
            pose=run.adapter.pose_of(k),
        )
        for k, plan in enumerate(plans)
    ]


def _output_status(spec: str, status: ReporterStatus) -> OutputStatus:
    latency, notice = status.latency, left_out(spec)
    return OutputStatus(
        spec=spec,
        left_out=None if notice is None else str(notice),
        failed=status.failed,
        reports=status.reports,
        unsent=list(status.unsent),
        ahead=list(status.ahead),
        dropped=status.dropped,
        latency_ms=None if latency is None else _ms(latency.p50, latency.p99, max=1e3 * latency.max),
    )


def _source_status(plan: RunConfig, description: str, replay: Replay | None) -> SourceStatus:
    if replay is None:
        return SourceStatus(spec=plan.source, description=description)
    shown = ReplayStatus(frame=replay.frame, frames=replay.frames, seconds=replay.seconds, **replay.controls._asdict())
    return SourceStatus(spec=plan.source, description=description, replay=shown)


def _absolute(path: Path | None) -> str | None:
    """Return the absolute path: clients run in other folders."""
    return None if path is None else str(path.absolute())


def _ms(median: float, slow: float, **longest: float) -> Quantiles:
    return Quantiles(p50=1e3 * median, p99=1e3 * slow, **longest)
