"""How what some tests talk to is fetched: the script, among programs that stand in for apt's and Python."""

import os
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "deploy" / "install-peers.sh"
PROGRAMS = {
    "dpkg-query": '[[ -f $STATE/$4 ]] && echo installed || echo "no packages found" >&2',
    "apt-get": 'echo "$*" >> "$STATE/calls"; [[ $1 == update || -z ${NO_APT:-} ]]',
    "id": 'echo "$UID_HERE"',
    # makes an environment whose own Python takes what it is told to install, or does not
    "python": 'mkdir -p "$3/bin"; printf \'#!/bin/bash\\n[[ -z ${NO_PIP:-} ]]\\n\' > "$3/bin/python"\n'
    'chmod +x "$3/bin/python"',
}


@pytest.fixture
def install(tmp_path: Path):
    """Runs the script; returns what it said."""
    (tmp_path / "bin").mkdir()
    for name, text in PROGRAMS.items():
        (tmp_path / "bin" / name).write_text(f"#!/bin/bash\n{text}\n")
        (tmp_path / "bin" / name).chmod(0o700)

    def run(present: str = "", user: int = 0, systemd: bool = False, **more: str) -> str:
        for name in present.split():
            (tmp_path / name).touch()
        env = {
            "PATH": f"{tmp_path}/bin:{os.environ['PATH']}",
            "STATE": str(tmp_path),
            "UID_HERE": str(user),
            "SYSTEMD_RUNS": str(tmp_path if systemd else tmp_path / "none"),
            "PYTHON": "python",
            **more,
        }
        done = subprocess.run(
            [SCRIPT, tmp_path / "env"], env=env, capture_output=True, text=True, check=True, timeout=60
        )
        return done.stderr

    return run


ALL = "openssh-server ser2net gcc libc6-dev"


def calls(folder: Path) -> str:
    return (folder / "calls").read_text() if (folder / "calls").exists() else ""


def test_what_is_there_is_not_installed_again(install, tmp_path: Path):
    assert "OctoPrint" in install(ALL)
    assert (tmp_path / "env" / ".installed").exists()
    assert install(ALL) == ""
    assert calls(tmp_path) == ""


def test_a_container_gets_the_packages_that_it_lacks(install, tmp_path: Path):
    said = install("gcc libc6-dev")
    assert "openssh-server ser2net" in said
    assert calls(tmp_path).splitlines() == ["install -y -qq --no-install-recommends openssh-server ser2net"]


@pytest.mark.parametrize(("user", "systemd"), [(1000, False), (0, True)])
def test_nobodys_own_computer_is_made_a_server(install, tmp_path: Path, user: int, systemd: bool):
    assert "are skipped" in install("gcc libc6-dev", user, systemd)
    assert calls(tmp_path) == ""


def test_what_cannot_be_had_is_said_and_fails_nothing(install, tmp_path: Path):
    said = install("", NO_APT="1", NO_PIP="1")
    assert said.count("skipped") == 2
    assert calls(tmp_path).splitlines()[1] == "update -qq"
    assert not (tmp_path / "env").exists()
