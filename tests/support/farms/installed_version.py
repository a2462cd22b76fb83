"""Versions of farm, each installed from its wheel into its own environment."""

import re
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
_SOURCES = ("farm", "drivers", "decompose", "slicing", "pyproject.toml", "README.md", "LICENSE")
_PIP_COMMAND = [sys.executable, "-m", "pip", "--disable-pip-version-check"]


def build_wheel(folder: Path, version: str | None = None) -> Path:
    """Build the wheel of the checkout, as another version if one is given; return its path.

    Parameters
    ----------
    folder
        New folder for a copy of the sources, so that the checkout stays clean.
    version
        Version of the wheel; None for the version of the checkout.
    """
    folder.mkdir(parents=True)
    for name in _SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(ROOT / name, folder / name)
    if version is not None:
        project = folder / "pyproject.toml"
        text, count = re.subn(r'(?m)^version = ".*"$', f'version = "{version}"', project.read_text())
        assert count == 1, project
        project.write_text(text)
    command = [*_PIP_COMMAND, "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "-w", folder / "dist", folder], check=True, cwd=folder)
    [path] = (folder / "dist").glob("farm-*.whl")
    return path


def install_wheel(wheel: Path, folder: Path) -> Path:
    """Install a wheel into a new environment that uses the dependencies of the current one.

    Returns
    -------
    Path
        Folder of its packages.
    """
    venv.create(folder)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    python = folder / "bin" / "python"
    command = [*_PIP_COMMAND, "--python", str(python), "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*command, "--no-compile", str(wheel)], check=True)
    return packages


class Versions:
    """Installed versions of farm, and the link that names the one in use.

    Parameters
    ----------
    folder
        Existing folder for all versions.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.link = folder / "farm"

    def install(self, version: str) -> Path:
        """Install a version; return the folder of its packages."""
        wheel = build_wheel(self._folder / f"sources-{version}", version)
        return install_wheel(wheel, self._folder / f"farm-{version}")

    def use(self, version: str) -> None:
        """Point the link to a version in one atomic step."""
        link = self._folder / "farm.new"
        link.symlink_to(self._folder / f"farm-{version}")
        link.replace(self.link)

    def find_version(self, folder: str) -> str | None:
        """Return the version whose packages are in a folder; None if the folder belongs to no version."""
        name = Path(folder).relative_to(self._folder).parts[0] if folder else ""
        return name.removeprefix("farm-") or None
