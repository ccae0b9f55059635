"""The service unit and the installer, as far as they can be judged without a running systemd."""

import configparser
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from cellctl.config import load_config

DEPLOY = Path(__file__).parent.parent / "deploy"
UNIT = DEPLOY / "cellctl.service"

needs_systemd = pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="systemd-analyze is not installed")


def run(*command: object, **options: object) -> subprocess.CompletedProcess:
    return subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, timeout=30, check=False, **options
    )


def unit() -> configparser.ConfigParser:
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    parser.optionxform = str
    parser.read(UNIT)
    return parser


@needs_systemd
def test_the_unit_is_accepted_by_systemd_without_a_warning(tmp_path):
    program = tmp_path / "cellctl"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    copy = tmp_path / "cellctl.service"
    copy.write_text(UNIT.read_text().replace("/opt/cellctl/venv/bin/cellctl", str(program)))
    verdict = run("systemd-analyze", "verify", "--man=no", copy)
    said = [line for line in (verdict.stdout + verdict.stderr).splitlines() if "cellctl" in line]
    assert (verdict.returncode, said) == (0, [])


@needs_systemd
def test_the_unit_is_hardened(tmp_path):
    verdict = run("systemd-analyze", "security", "--offline=true", UNIT)
    score = re.search(r"exposure level for cellctl\.service: ([\d.]+)", verdict.stdout)
    assert score, verdict.stdout + verdict.stderr
    assert float(score[1]) <= 2.0


def test_wrong_settings_are_not_tried_again_and_a_crash_is():
    service = unit()["Service"]
    assert service["Restart"] == "on-failure"
    assert service["RestartPreventExitStatus"] == "78"


def test_the_watchdog_is_slower_than_the_daemons_own_patience():
    assert float(unit()["Service"]["WatchdogSec"]) > load_config(DEPLOY / "cell.toml").watchdog.progress_within_s


def test_the_service_writes_only_where_the_settings_say():
    service, paths = unit()["Service"], load_config(DEPLOY / "cell.toml").paths
    assert paths.state == Path("/var/lib") / service["StateDirectory"]
    assert paths.log == Path("/var/log") / service["LogsDirectory"]
    assert paths.control_socket.parent == Path("/run") / service["RuntimeDirectory"]
    assert "ConfigurationDirectory" not in service


def test_paths_that_must_stay_read_only_are_not_named_for_execution():
    """systemd 252 takes ProtectSystem=strict away from a path that NoExecPaths= or ExecPaths= names."""
    service = unit()["Service"]
    assert "ExecPaths" not in service
    writable = ("/tmp", "/var/tmp", "/dev/shm", "/var/lib/cellctl", "/var/log/cellctl", "/run/cellctl")
    assert set(service["NoExecPaths"].split()) <= set(writable)


def test_the_receive_buffer_takes_several_pictures():
    (size,) = re.findall(r"(?m)^net\.core\.rmem_max = (\d+)$", (DEPLOY / "90-cellctl.sysctl.conf").read_text())
    assert int(size) >= 16 * 1024 * 1024


@pytest.mark.skipif(not shutil.which("setpriv"), reason="setpriv is not installed")
def test_the_installer_refuses_clearly_when_it_is_not_root():
    verdict = run("setpriv", "--reuid=65534", "--", "sh", DEPLOY / "install.sh")
    if "setpriv" in verdict.stderr:  # we are not root ourselves
        verdict = run("sh", DEPLOY / "install.sh")
    assert verdict.returncode == 1
    assert verdict.stderr.startswith("install.sh: must be run as root")
    assert verdict.stdout == ""


def test_the_installer_lays_its_files_out_twice_and_keeps_what_people_wrote(tmp_path):
    install = ("env", f"DESTDIR={tmp_path}", "sh", DEPLOY / "install.sh")
    assert run(*install).returncode == 0
    etc = tmp_path / "etc"
    assert {str(path.relative_to(etc)) for path in etc.rglob("*") if path.is_file()} == {
        "cellctl/cell.toml",
        *(f"cellctl/recipes/{path.name}" for path in (DEPLOY.parent / "recipes").glob("*.toml")),
        "systemd/system/cellctl.service",
        "sysctl.d/90-cellctl.conf",
        "udev/rules.d/99-cellctl.rules",
    }
    (etc / "cellctl/cell.toml").write_text("# mine")
    (etc / "systemd/system/cellctl.service").write_text("old")
    assert run(*install).returncode == 0
    assert (etc / "cellctl/cell.toml").read_text() == "# mine"
    assert (etc / "systemd/system/cellctl.service").read_text() == UNIT.read_text()


def test_the_installer_refuses_arguments_that_it_does_not_know(tmp_path):
    verdict = run("env", f"DESTDIR={tmp_path}", "sh", DEPLOY / "install.sh", "--force")
    assert verdict.returncode == 1
    assert "unknown argument --force" in verdict.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_installer_speaks_plain_shell():
    assert run("sh", "-n", DEPLOY / "install.sh").stderr == ""
    assert DEPLOY.joinpath("install.sh").stat().st_mode & 0o111
