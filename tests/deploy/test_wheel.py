"""The wheel, installed into its own environment outside the checkout, as pipx and uv do."""

import os
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

from decompose.jit import INSTALLED_FOLDER
from farms.installed_version import ROOT, build_wheel, install_wheel
from hosts.apt_host import Host

BROWSER_SOURCES = "farm/web/pages/browser/"
"""Sources that `deploy/build-pages.sh` bundles; the wheel has only the bundle."""
BUNDLE = "farm/web/pages/built"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from a copy, so that the checkout stays clean."""
    return build_wheel(tmp_path_factory.mktemp("wheel") / "sources")


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the wheel into a new environment, with the current dependencies; return its folder."""
    folder = tmp_path_factory.mktemp("clean") / "farm"
    packages = install_wheel(wheel, folder)
    # Reuse the compiled code of the checkout, because compiling takes a minute.
    shutil.copytree(
        INSTALLED_FOLDER, packages / "decompose" / "__pycache__" / INSTALLED_FOLDER.name, dirs_exist_ok=True
    )
    return folder


def run_farm(environment: Path, host: Host, *arguments: str) -> tuple[int, str]:
    """Run `farm` of the environment outside the checkout; return the exit code and the output."""
    home = {"HOME": str(host.folder), "FARM_STATE": str(host.folder / "farm-state")}
    process = subprocess.run(
        [environment / "bin" / "farm", *arguments],
        env=host.environ | home,
        cwd=host.folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return process.returncode, process.stdout


def test_wheel_contains_all_files_of_the_packages_in_git(wheel: Path):
    command = ["git", "ls-files", "farm", "drivers", "decompose", "slicing"]
    git_files = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    assert len(git_files) > 100
    bundle = {f"{BUNDLE}/{path.name}" for path in (ROOT / BUNDLE).glob("[!.]*")}
    expected = {name for name in git_files if not name.startswith(BROWSER_SOURCES)} | bundle
    with zipfile.ZipFile(wheel) as archive:
        assert expected - set(archive.namelist()) == set()


def test_setup_installs_what_the_doctor_reports_as_missing(environment: Path, tmp_path: Path):
    host = Host(tmp_path, apt="4.13")
    _, doctor_before = run_farm(environment, host, "doctor")
    missing_items = [line for line in doctor_before.splitlines() if line.startswith("problem  cura")]
    assert len(missing_items) == 2 and all(line.count("farm setup") == 1 for line in missing_items)

    code, output = run_farm(environment, host, "setup")
    assert code == 0, output
    settings = environment / "share" / "farm" / "cura"
    assert f"its settings are in {settings}" in output
    assert "install -y -qq --no-install-recommends cura-engine" in host.calls

    _, doctor_after = run_farm(environment, host, "doctor")
    assert "problem  cura" not in doctor_after
    assert f"ok       cura: {settings}" in doctor_after
    assert f"ok       code: the planning code is compiled in {environment}" in doctor_after


def test_setup_without_apt_names_the_missing_packages(environment: Path, tmp_path: Path):
    shutil.rmtree(environment / "share", ignore_errors=True)
    code, output = run_farm(environment, Host(tmp_path), "setup")
    assert code == 1
    assert "There is no apt here" in output and "FARM_CURA_RESOURCES" in output
    assert output.splitlines()[-1].startswith("farm: CuraEngine and its settings in")


def test_installed_program_has_the_version_of_the_wheel(environment: Path, wheel: Path, tmp_path: Path):
    code, output = run_farm(environment, Host(tmp_path), "--version")
    assert (code, output) == (0, f"farm {wheel.name.split('-')[1]}\n")
    assert os.access(environment / "bin" / "farm", os.X_OK)
