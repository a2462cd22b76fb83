"""The wheel, installed into an environment of its own outside the checkout, as pipx and uv do."""

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

from apt_host import Host
from decompose.jit import INSTALLED

ROOT = Path(__file__).resolve().parents[2]
BROWSER_SOURCES = "farm/web/pages/browser/"
"""Bundled by `deploy/build-pages.sh`: the wheel has the bundle."""
BUNDLE = "farm/web/pages/built"
PARTS = ("farm", "drivers", "decompose", "slicing", "pyproject.toml", "README.md", "LICENSE")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from a copy, so that nothing is left in the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    for name in PARTS:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy2
        copy(ROOT / name, folder / name)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "--no-index", "-w", folder / "dist", folder], check=True, cwd=folder)
    [path] = (folder / "dist").glob("farm-*.whl")
    return path


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the wheel, with the dependencies that this environment has."""
    folder = tmp_path_factory.mktemp("clean") / "farm"
    venv.create(folder)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    command = [sys.executable, "-m", "pip", "--python", folder / "bin" / "python", "install", "--quiet"]
    subprocess.run([*command, "--no-deps", "--no-index", wheel], check=True)
    # Where the checkout is compiled, so is this: it takes a minute, and is the same code.
    shutil.copytree(INSTALLED, packages / "decompose" / "__pycache__" / INSTALLED.name, dirs_exist_ok=True)
    return folder


def run(environment: Path, host: Host, *arguments: str) -> tuple[int, str]:
    """Run `farm` of the environment on a computer, far from the checkout."""
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


def test_wheel_has_all_files_of_the_packages_that_git_has(wheel: Path):
    command = ["git", "ls-files", "farm", "drivers", "decompose", "slicing"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    assert len(listed) > 100
    bundle = {f"{BUNDLE}/{path.name}" for path in (ROOT / BUNDLE).glob("[!.]*")}
    expected = {name for name in listed if not name.startswith(BROWSER_SOURCES)} | bundle
    with zipfile.ZipFile(wheel) as archive:
        assert expected - set(archive.namelist()) == set()


def test_setup_installs_what_the_doctor_misses(environment: Path, tmp_path: Path):
    host = Host(tmp_path, apt="4.13")
    _, before = run(environment, host, "doctor")
    missing = [line for line in before.splitlines() if line.startswith("problem  cura")]
    assert len(missing) == 2 and all(line.count("farm setup") == 1 for line in missing)

    code, output = run(environment, host, "setup")
    assert code == 0, output
    settings = environment / "share" / "farm" / "cura"
    assert f"its settings are in {settings}" in output
    assert "install -y -qq --no-install-recommends cura-engine" in host.calls

    _, after = run(environment, host, "doctor")
    assert "problem  cura" not in after
    assert f"ok       cura: {settings}" in after
    assert f"ok       code: the planning code is compiled in {environment}" in after


def test_setup_names_missing_packages_without_apt(environment: Path, tmp_path: Path):
    shutil.rmtree(environment / "share", ignore_errors=True)
    code, output = run(environment, Host(tmp_path), "setup")
    assert code == 1
    assert "There is no apt here" in output and "FARM_CURA_RESOURCES" in output
    assert output.splitlines()[-1].startswith("farm: CuraEngine and its settings in")


def test_version_is_that_of_the_wheel(environment: Path, wheel: Path, tmp_path: Path):
    code, output = run(environment, Host(tmp_path), "--version")
    assert (code, output) == (0, f"farm {wheel.name.split('-')[1]}\n")
    assert os.access(environment / "bin" / "farm", os.X_OK)
