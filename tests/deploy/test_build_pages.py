"""Bundle of the scripts for pages: its sources, size and licence."""

import gzip
import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "farm/web/pages/browser"
SCRIPT = "deploy/build-pages.sh"
MAX_BUNDLE_BYTES = 250_000


def test_libraries_are_pinned_by_hashes_without_a_host():
    text = (SOURCES / "package-lock.json").read_text()
    packages = {name: package for name, package in json.loads(text)["packages"].items() if name}
    assert packages
    assert all(package["integrity"].startswith("sha512-") for package in packages.values())
    assert "resolved" not in text
    assert "http" not in json.dumps([package.get("version") for package in packages.values()])
    required = json.loads((SOURCES / "package.json").read_text())
    for name, version in {**required["dependencies"], **required["devDependencies"]}.items():
        assert packages[f"node_modules/{name}"]["version"] == version


def test_bundle_is_small_and_contains_the_licence():
    bundle = ROOT / "farm/web/pages/built/viewer.js"
    if not bundle.exists():
        pytest.skip("the scripts of the pages are not built: make pages")
    assert len(gzip.compress(bundle.read_bytes())) < MAX_BUNDLE_BYTES
    assert "MIT License" in bundle.with_name("three.LICENSE.txt").read_text()


def test_installation_continues_without_node_and_keeps_no_old_bundle(tmp_path):
    checkout = tmp_path / "checkout"
    (checkout / "deploy").mkdir(parents=True)
    shutil.copy(ROOT / SCRIPT, checkout / "deploy")
    shutil.copytree(SOURCES, checkout / "farm/web/pages/browser")
    bundle_folder = checkout / "farm/web/pages/built"
    bundle_folder.mkdir()
    (bundle_folder / "viewer.js").write_text("old")
    (bundle_folder / ".sources").write_text("digest of earlier sources")
    tools = tmp_path / "tools"  # all programs that the script needs, except npm
    tools.mkdir()
    for name in ("bash", "cat", "cp", "cut", "dirname", "env", "mkdir", "rm", "sha256sum"):
        (tools / name).symlink_to(shutil.which(name))
    (tools / "python").write_text("#!/bin/sh\nexit 1\n")  # pip has no network
    (tools / "python").chmod(0o755)
    result = subprocess.run(
        [checkout / SCRIPT, "python"], env={**os.environ, "PATH": str(tools)}, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    assert "The pages work without their 3D view" in result.stderr
    assert not bundle_folder.exists()
