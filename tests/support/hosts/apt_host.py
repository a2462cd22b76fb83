"""Computer with stand-ins for the programs of apt, for tests of `install-cura.sh`."""

import shutil
import subprocess
from pathlib import Path

SCRIPT = Path(__file__).resolve().parents[3] / "slicing" / "install-cura.sh"
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
SETTING_VERSIONS = {"4.8": 16, "4.13": 19, "5.0": 20, "5.2": 21}

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


def create_resources(folder, version):
    """Create the files that identify a folder as Cura's resources; return the folder."""
    for name in ("definitions", "extruders", "variants", "quality", "materials"):
        (folder / name).mkdir(parents=True)
    text = f'{{"metadata": {{"setting_version": {SETTING_VERSIONS[version]}}}}}\n'
    (folder / "definitions" / "fdmprinter.def.json").write_text(text.replace("}}", "}\n}"))
    (folder / "definitions" / "ultimaker2_plus.def.json").write_text("{}")
    (folder / "materials" / "generic_pla.xml.fdm_material").write_text("<a/>")
    return folder


class Host:
    """A computer whose apt offers a given version of Cura."""

    def __init__(self, folder, *, apt=None, has_lists=True, packaged_version=None):
        self.folder, self.bin, self.state = folder, folder / "bin", folder / "state"
        self.bin.mkdir()
        self.state.mkdir()
        for tool in TOOLS:
            (self.bin / tool).symlink_to(shutil.which(tool))
        self.add_program("id", "#!/bin/bash\n[[ $1 == -u ]] && echo 0 || echo root\n")
        if apt is not None:
            self.add_program("apt-cache", APT_CACHE)
            self.add_program("apt-get", APT_GET)
            self.add_program("dpkg-deb", DPKG_DEB)
            for package in ("cura", "fdm-materials", "cura-engine"):
                epoch = "1:" if package == "cura-engine" else ""
                (self.state / f"candidate-{package}").write_text(f"{epoch}{apt}.0-6")
            self.add_engine(apt, self.state / "new-engine")
            create_resources(self.state / "packaged", packaged_version or apt)
        if has_lists:
            (self.state / "lists").touch()

    def add_program(self, name, text):
        (self.bin / name).write_text(text)
        (self.bin / name).chmod(0o755)

    def add_engine(self, version, path=None):
        path = path or self.bin / "CuraEngine"
        path.write_text(f"#!/bin/bash\necho\necho 'Cura_SteamEngine version {version}.0' >&2\nexit 1\n")
        path.chmod(0o755)
        return path

    @property
    def settings(self):
        """Folder for Cura's settings."""
        return self.folder / "farm" / ".cura" / "resources"

    def run(self, **environ):
        command = [self.bin / "bash", SCRIPT, self.settings]
        result = subprocess.run(
            command, env=self.environ | environ, capture_output=True, text=True, check=False
        )
        return result.returncode, result.stderr, self.calls

    @property
    def environ(self):
        """Environment variables of the computer's processes."""
        return {
            "PATH": str(self.bin),
            "STATE": str(self.state),
            "BIN": str(self.bin),
            "TMPDIR": str(self.folder),
        }

    @property
    def calls(self):
        """Calls of apt-get, one on each line."""
        calls = self.state / "calls"
        return calls.read_text() if calls.exists() else ""
