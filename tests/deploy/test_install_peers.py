"""Tests of the script that installs the peers of interop tests, with stand-ins for apt and Python."""

import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "deploy" / "install-peers.sh"
TOOLS = "awk bash cat chmod dirname env find id mkdir paste rm sh sort touch xargs"
PROGRAMS = {
    # Each package depends on a library.
    "apt-get": """
case " $* " in
    *" -s install "*)
        [[ -z ${LACKS:-} || " $* " != *" $LACKS "* ]] || exit 100
        echo "Inst fonts-x (1)"; echo "Inst libx (1)"; printf 'Inst %s (1)\n' "${@:4}" ;;
    *" download "*) [[ -z ${NO_APT:-} ]] || exit 100; while [[ $1 != -qq ]]; do shift; done
        for name in "${@:2}"; do echo "$name" >> "$STATE/downloaded"; touch "$name.deb"; done ;;
    *) echo "$*" >> "$STATE/other-calls" ;;
esac
""",
    "dpkg-deb": """
put() {
    mkdir -p "$(dirname "$1")"
    printf '#!/bin/sh\\necho "$0 $LD_LIBRARY_PATH $*"\\n' > "$1"; chmod +x "$1"
}
case $2 in
    *libx.deb) put "$3/usr/lib/x.so.1" ;;
    *openssh-client.deb) put "$3/usr/bin/ssh"; put "$3/usr/bin/ssh-keygen" ;;
    *openssh-server.deb) put "$3/usr/sbin/sshd" ;;
    *ser2net.deb) put "$3/usr/sbin/ser2net" ;;
    *prusa-slicer.deb) put "$3/usr/bin/prusa-slicer" ;;
    *prometheus.deb) put "$3/usr/bin/promtool" ;;
    *tcc.deb) put "$3/usr/bin/tcc"; put "$3/usr/lib/tcc/libtcc1.a" ;;
esac
""",
    # It makes an environment whose own Python accepts or refuses an installation.
    "python": """
mkdir -p "$3/bin"; printf '#!/bin/bash\\n[[ -z ${NO_PIP:-} ]]\\n' > "$3/bin/python"; chmod +x "$3/bin/python"
""",
}


@pytest.fixture
def install(tmp_path: Path):
    """Return a function that runs the script on a host with the programs `present` and returns its output."""
    (tmp_path / "bin").mkdir()
    for name in TOOLS.split():
        (tmp_path / "bin" / name).symlink_to(shutil.which(name) or "/")
    for name, text in PROGRAMS.items():
        (tmp_path / "bin" / name).write_text(f"#!/bin/bash\n{text}\n")
        (tmp_path / "bin" / name).chmod(0o700)

    def run(present: str = "", **variables: str) -> str:
        for name in present.split():
            (tmp_path / "bin" / name).symlink_to("/bin/true")
        env = {
            "PATH": f"{tmp_path}/bin",
            "SBIN": "/none",
            "STATE": str(tmp_path),
            "PYTHON": "python",
            **variables,
        }
        command = [SCRIPT, tmp_path / "env"]
        result = subprocess.run(command, env=env, capture_output=True, text=True, check=True, timeout=60)
        return result.stderr

    return run


def list_downloads(folder: Path) -> set[str]:
    return set((folder / "downloaded").read_text().split()) if (folder / "downloaded").exists() else set()


def test_installed_packages_are_not_fetched(install, tmp_path: Path):
    assert "OctoPrint" in install("ssh ssh-keygen sshd ser2net tcc promtool prusa-slicer")
    assert install() == ""
    assert not list_downloads(tmp_path)


def test_missing_packages_are_unpacked_and_not_installed(install, tmp_path: Path):
    install("ssh ssh-keygen")
    assert list_downloads(tmp_path) == {
        *("libx", "openssh-server", "prometheus", "prusa-slicer", "ser2net", "tcc")
    }
    assert not (tmp_path / "other-calls").exists()
    unpacked_folder = tmp_path / "env" / "debian" / "usr"
    output = subprocess.check_output([tmp_path / "env" / "bin" / "sshd", "-D", "a b"], text=True, env={})
    assert output == f"{unpacked_folder}/sbin/sshd {unpacked_folder}/lib -D a b\n"
    output = subprocess.check_output([tmp_path / "env" / "bin" / "tcc", "x.c"], text=True, env={})
    assert output.endswith(f" -B{unpacked_folder}/lib/tcc x.c\n")
    assert install() == ""


def test_unavailable_package_is_reported_without_failure(install, tmp_path: Path):
    output = install(NO_APT="1", NO_PIP="1")
    assert output.count("skipped") == 3
    assert not (tmp_path / "env" / "bin" / "sshd").exists()
    assert not (tmp_path / "env" / ".installed").exists()


def test_missing_large_package_does_not_affect_the_others(install, tmp_path: Path):
    assert "apt: prusa-slicer. The tests" in install(LACKS="prusa-slicer")
    assert (tmp_path / "env" / "bin" / "promtool").exists()


def test_server_with_fixed_paths_is_skipped(install, tmp_path: Path):
    """Skip OpenSSH 9.8 and later, whose server needs a program at a fixed path."""
    program = tmp_path / "bin" / "dpkg-deb"
    program.write_text(
        program.read_text() + '\n[[ $2 != *openssh-server.deb ]] || put "$3/usr/lib/openssh/sshd-session"\n'
    )
    assert "apt: sshd. The tests" in install("ssh ssh-keygen")
    assert (tmp_path / "env" / "bin" / "tcc").exists()
    assert not (tmp_path / "env" / "bin" / "sshd").exists()
