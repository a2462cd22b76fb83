"""Installation of CuraEngine and Cura's settings: the script, with stand-ins for the programs of apt."""

import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "deploy" / "install-cura.sh"
TOOLS = (
    "bash",
    "cat",
    "cp",
    "dirname",
    "env",
    "head",
    "mkdir",
    "mktemp",
    "mv",
    "rm",
    "sed",
    "touch",
    "chmod",
)
NUMBERS = {"4.8": 16, "4.13": 19, "5.0": 20, "5.2": 21}

APT_CACHE = """#!/bin/bash
[[ -f $STATE/lists ]] || exit 0
printf '%s:\\n  Candidate: %s\\n' "$2" "$(cat "$STATE/candidate-$2" 2>/dev/null)"
"""
APT_GET = """#!/bin/bash
echo "apt-get $*" >> "$STATE/calls"
case " $* " in
    *" update "*) touch "$STATE/lists" ;;
    *" install "*) cp "$STATE/new-engine" "$BIN/CuraEngine" ;;
    *" download "*) touch cura_1_all.deb fdm-materials_1_all.deb ;;
esac
"""
DPKG_DEB = """#!/bin/bash
mkdir -p "$3/usr/share/cura"
cp -r "$STATE/packaged" "$3/usr/share/cura/resources" 2>/dev/null
exit 0
"""


def resources(folder, version):
    """Create the files by which a resources folder is recognised."""
    for name in ("definitions", "extruders", "variants", "quality", "materials"):
        (folder / name).mkdir(parents=True)
    text = f'{{"metadata": {{"setting_version": {NUMBERS[version]}}}}}\n'
    (folder / "definitions" / "fdmprinter.def.json").write_text(text.replace("}}", "}\n}"))
    (folder / "definitions" / "ultimaker2_plus.def.json").write_text("{}")
    (folder / "materials" / "generic_pla.xml.fdm_material").write_text("<a/>")
    return folder


class Host:
    """A computer with an apt of a given version, and what is on it."""

    def __init__(self, folder, *, apt=None, lists=True, packaged=None):
        self.folder, self.bin, self.state = folder, folder / "bin", folder / "state"
        self.bin.mkdir()
        self.state.mkdir()
        (folder / "farm" / "deploy").mkdir(parents=True)
        shutil.copy(SCRIPT, folder / "farm" / "deploy")
        for tool in TOOLS:
            (self.bin / tool).symlink_to(shutil.which(tool))
        self.program("id", "#!/bin/bash\n[[ $1 == -u ]] && echo 0 || echo root\n")
        if apt is not None:
            self.program("apt-cache", APT_CACHE)
            self.program("apt-get", APT_GET)
            self.program("dpkg-deb", DPKG_DEB)
            for package in ("cura", "fdm-materials", "cura-engine"):
                epoch = "1:" if package == "cura-engine" else ""
                (self.state / f"candidate-{package}").write_text(f"{epoch}{apt}.0-6")
            self.engine(apt, self.state / "new-engine")
            resources(self.state / "packaged", packaged or apt)
        if lists:
            (self.state / "lists").touch()

    def program(self, name, text):
        (self.bin / name).write_text(text)
        (self.bin / name).chmod(0o755)

    def engine(self, version, path=None):
        path = path or self.bin / "CuraEngine"
        path.write_text(f"#!/bin/bash\necho\necho 'Cura_SteamEngine version {version}.0' >&2\nexit 1\n")
        path.chmod(0o755)
        return path

    @property
    def settings(self):
        return self.folder / "farm" / ".cura" / "resources"

    def run(self, **environ):
        known = {
            "PATH": str(self.bin),
            "STATE": str(self.state),
            "BIN": str(self.bin),
            "TMPDIR": str(self.folder),
        }
        script = self.folder / "farm" / "deploy" / SCRIPT.name
        done = subprocess.run(
            [self.bin / "bash", script], env=known | environ, capture_output=True, text=True, check=False
        )
        calls = self.state / "calls"
        return done.returncode, done.stderr, calls.read_text() if calls.exists() else ""


class TestInstall:
    @pytest.mark.parametrize("version", ["4.13", "5.0"])
    def test_everything_is_fetched_of_one_version(self, tmp_path, version):
        host = Host(tmp_path, apt=version)
        code, message, calls = host.run()
        assert (code, message.splitlines()[-1]) == (
            0,
            f"install: CuraEngine {version} and Cura's settings are in place.",
        )
        assert "install -y -qq --no-install-recommends cura-engine" in calls
        assert "install cura\n" not in calls
        assert (host.settings / "materials" / "generic_pla.xml.fdm_material").is_file()
        assert host.run()[0] == 0
        assert (host.state / "calls").read_text() == calls  # the second time asks nobody

    def test_lists_that_are_empty_are_refreshed_once(self, tmp_path):
        code, _, calls = Host(tmp_path, apt="5.0", lists=False).run()
        assert code == 0
        assert calls.count("update") == 1

    @pytest.mark.parametrize("version", ["4.13", "5.0", "5.2"])
    def test_given_engine_that_fits_is_used(self, tmp_path, version):
        host = Host(tmp_path)
        engine = host.engine(version, tmp_path / "mine")
        given = resources(tmp_path / "cura", version)
        code, message, calls = host.run(FARM_CURA_ENGINE=str(engine), FARM_CURA_RESOURCES=str(given))
        assert (code, message, calls) == (0, "", "")

    @pytest.mark.parametrize(
        ("engine", "settings", "wrong"),
        [
            ("4.8", "4.13", "is not CuraEngine 4.13 or 5"),
            ("5.0", "4.13", "CuraEngine is 5.0, and FARM_CURA_RESOURCES="),
            ("4.13", "5.0", "CuraEngine is 4.13, and FARM_CURA_RESOURCES="),
            ("5.0", None, "is not Cura's resources folder"),
        ],
    )
    def test_given_engine_that_does_not_fit_is_refused(self, tmp_path, engine, settings, wrong):
        host = Host(tmp_path)
        folder = resources(tmp_path / "cura", settings) if settings else tmp_path
        program = host.engine(engine, tmp_path / "mine")
        code, message, _ = host.run(FARM_CURA_ENGINE=str(program), FARM_CURA_RESOURCES=str(folder))
        assert code == 1
        assert wrong in message

    def test_settings_of_another_version_are_replaced(self, tmp_path):
        host = Host(tmp_path, apt="5.0")
        host.engine("5.0")
        resources(host.settings, "4.13")
        code, _, calls = host.run()
        assert code == 0
        assert "cura-engine" not in calls
        assert '"setting_version": 20' in (host.settings / "definitions" / "fdmprinter.def.json").read_text()

    def test_an_apt_of_another_version_than_the_engine_is_no_help(self, tmp_path):
        host = Host(tmp_path, apt="5.0")
        host.engine("4.13")
        code, message, _ = host.run()
        assert code == 1
        assert "apt has no version 4.13 of: cura fdm-materials" in message
        assert not host.settings.exists()

    @pytest.mark.parametrize(
        ("host", "message"),
        [
            ({}, "There is no apt here"),
            ({"apt": "4.8"}, "apt has no version 4.13 or 5"),
            ({"apt": "5.0", "packaged": "4.13"}, "has not the settings of CuraEngine 5.0"),
        ],
    )
    def test_unavailable_engine_is_reported_with_its_requirements(self, tmp_path, host, message):
        code, errors, _ = Host(tmp_path, **host).run()
        assert code == 1
        assert message in errors
        assert "FARM_CURA_ENGINE" in errors
