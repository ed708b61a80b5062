"""Findings of sources and outputs about their devices, which are not opened."""

import os
import stat
import sys
from functools import partial
from types import SimpleNamespace

import pytest
import reporting

from spheremouse import output
from spheremouse.capture import nodes
from spheremouse.errors import OutputError
from spheremouse.files import access
from spheremouse.finding import Verdict, absent, ok
from spheremouse.output import auto, serial, text, uinput

OK, WARNING, WRONG, UNCHECKED = Verdict.OK, Verdict.WARNING, Verdict.WRONG, Verdict.UNCHECKED


def cameras(tmp_path, names):
    """The cameras of a computer with these nodes: (index, name, lasting name or None)."""
    listed, devices, by_id = tmp_path / "sys", tmp_path / "dev", tmp_path / "by-id"
    by_id.mkdir()
    devices.mkdir()
    for k, (index, name, lasting) in enumerate(names):
        (listed / f"video{k}").mkdir(parents=True)
        (listed / f"video{k}" / "name").write_text(name + "\n")
        (listed / f"video{k}" / "index").write_text(f"{index}\n")
        (devices / f"video{k}").write_text("")
        if lasting:
            (by_id / lasting).symlink_to(devices / f"video{k}")
    return nodes.nodes(listed, devices, by_id)


def test_cameras_are_listed_by_their_first_node_and_lasting_name(tmp_path):
    found = cameras(tmp_path, [(0, "HD Cam", "usb-HD-index0"), (1, "HD Cam", "usb-HD-index1"), (0, "Other", None)])
    assert [(n.name, n.lasting and n.lasting.name) for n in found] == [("HD Cam", "usb-HD-index0"), ("Other", None)]
    numbered, access_ = nodes.probe_node(tmp_path / "dev" / "video0", found)
    assert numbered.verdict is WARNING
    assert f"source: v4l2:{tmp_path}/by-id/usb-HD-index0" in numbered.advice
    assert access_.verdict is OK
    assert nodes.probe_node(tmp_path / "by-id" / "usb-HD-index0", found)[0].verdict is OK
    (missing,) = nodes.probe_node(tmp_path / "dev" / "video9", found)
    assert (missing.verdict, missing.passing) == (WRONG, True)
    assert nodes.nodes(tmp_path / "nowhere") == []
    if sys.platform.startswith("linux"):
        assert nodes.default_camera([]) == "v4l2:/dev/video0"
        assert nodes.default_camera(found[::-1]) == f"v4l2:{tmp_path}/by-id/usb-HD-index0"


def test_the_default_camera_of_other_systems_is_the_first_one_of_opencv(monkeypatch):
    monkeypatch.setattr(sys, "platform", "darwin")
    assert nodes.default_camera() == "opencv:0"


def test_a_node_that_may_not_be_used_names_its_group_and_the_account(tmp_path, monkeypatch):
    node = tmp_path / "video0"
    node.write_text("")
    assert access.access_problem(node) is None
    monkeypatch.setattr(access, "group_of", lambda path: "video")
    monkeypatch.setattr(access, "account", lambda: "ada")
    node.chmod(0o660)
    monkeypatch.setattr(access.os, "access", lambda path, mode: False)
    monkeypatch.setattr("grp.getgrall", lambda: [])
    assert access.access_problem(node) == (
        f"{node} belongs to the group video, and ada is no member",
        "as root: usermod -aG video ada, then log in again",
    )
    monkeypatch.setattr("grp.getgrall", lambda: [SimpleNamespace(gr_name="video", gr_mem=["ada"])])
    assert access.access_problem(node)[1] == "log out and in again"
    node.chmod(0o600)
    problem, remedy = access.access_problem(node)
    assert "by its owner alone" in problem
    assert "service install" in remedy


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become somebody else")
def test_another_account_is_really_refused(tmp_path, monkeypatch):
    node = tmp_path / "uinput"
    monkeypatch.setattr(uinput, "NODE", node)
    node.write_text("")
    node.chmod(0o600)
    for folder in (tmp_path, *tmp_path.parents):
        if folder.stat().st_uid == 0 and "pytest" in str(folder):
            folder.chmod(folder.stat().st_mode | stat.S_IXOTH | stat.S_IROTH)
    pid = os.fork()
    if pid == 0:
        os.setgroups([])
        os.setgid(65534)
        os.setuid(65534)
        (finding,) = uinput.probe("")
        os._exit(0 if finding.verdict is WRONG and "by its owner alone" in finding.text else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0


def test_outputs_are_not_opened(tmp_path, monkeypatch):
    monkeypatch.setattr(uinput, "NODE", tmp_path / "uinput")
    (missing,) = uinput.probe("")
    assert (missing.verdict, missing.passing) == (WRONG, True)
    assert "modprobe uinput" in missing.advice
    (missing,) = serial.probe(str(tmp_path / "ttyACM9"))
    assert (missing.verdict, missing.passing) == (WRONG, True)
    (tmp_path / "ttyACM0").write_text("")
    assert serial.probe(str(tmp_path / "ttyACM0"))[0].verdict is OK
    assert output.probe("null")[0].verdict is WARNING


def test_a_log_of_motions_may_be_appended_to_and_other_files_may_not(tmp_path):
    log = tmp_path / "log"
    assert output.probe(f"text:{log}")[0].verdict is OK
    assert not log.exists()
    (finding,) = output.probe(f"text:{tmp_path}/nowhere/log")
    assert (finding.verdict, finding.passing) == (WRONG, False)
    assert output.probe(f"text:{tmp_path}")[0].verdict is WRONG
    log.write_text("a letter")
    with pytest.raises(OutputError, match="no log in this format"):
        output.probe(f"text:{log}")
    log.unlink()
    with text.open(str(log)) as opened:
        opened.send(reporting.report())
    assert output.probe(f"text:{log}")[0].verdict is OK


def test_auto_names_the_output_that_it_takes_and_the_third_axis(monkeypatch):
    def set_all(finding):
        monkeypatch.setattr(uinput, "probe", lambda argument: [finding("uinput")])
        for module in (auto.desktop, auto.serial):
            monkeypatch.setattr(module, "probe", lambda argument: [absent("other", "is not there", "")])

    set_all(partial(ok, text="may be written"))
    taken, *others, third = output.probe("auto")
    assert taken.text == "auto takes uinput"
    assert [f.verdict for f in others] == [OK, UNCHECKED, UNCHECKED]
    assert third.text == "the third axis (the ball's spin) is not sent: output auto has no `third=`"
    assert output.probe("uinput:third=wheel")[-1].text == "the ball's spin is sent as the wheel (REL_WHEEL_HI_RES)"
    set_all(partial(absent, text="is not there", advice=""))
    assert [f.verdict for f in output.probe("auto")] == [WRONG, WARNING, WARNING, WARNING, OK]
