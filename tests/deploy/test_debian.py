"""Parts of the Debian package that can be tested on any host; `make test-deb` tests the whole package."""

import importlib.util
import re
import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import pytest

from drivers.printers import PROFILES
from farm.cli.command_group import load_commands
from farm.cli.main import app
from farm.fleet_file import load_fleet
from farm.planning.inspection import complete_section

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
DEBIAN = DEPLOY / "debian"
MODELS = frozenset(PROFILES)
SKIP_STATUS = 77
"""Exit status of a script that cannot run on this host."""


@pytest.fixture(scope="module")
def command_files() -> ModuleType:
    spec = importlib.util.spec_from_file_location("command_files", DEBIAN / "command_files.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def share(command_files: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("share")
    command_files.write_files(folder, "1.2.3-x")
    return folder


def test_fleet_file_of_the_package_lists_no_printer_and_opens_no_port():
    fleet = load_fleet(DEBIAN / "fleet.yaml", MODELS, complete_section)
    assert (fleet.printers, fleet.web) == ((), None)


def test_every_commented_line_of_the_fleet_file_is_valid(tmp_path: Path):
    text = (DEBIAN / "fleet.yaml").read_text()
    body = text[text.index("fleet:") :].replace("printers: []", "printers:")
    uncommented = re.sub(r"(?m)^( *)# ?( *)(- \{|web:|attended:)", r"\1\2\3", body)
    (tmp_path / "fleet.yaml").write_text(uncommented)
    fleet = load_fleet(tmp_path / "fleet.yaml", MODELS)
    assert len(fleet.printers) == 3 and fleet.web is not None and fleet.fleet.attended


def test_fleet_of_the_container_is_simulated_and_opens_no_port():
    fleet = load_fleet(DEPLOY / "container" / "fleet.yaml", MODELS, complete_section)
    assert fleet.printers and all(section.is_simulated for section in fleet.printers)
    assert fleet.web is None


def test_every_command_has_a_man_page_that_names_its_options(share: Path):
    for name, command in load_commands(app).items():
        page = (share / "man" / "man1" / f"farm-{name}.1").read_text().replace("\\-", "-")
        for param in command.params:
            if param.param_type_name != "argument" and not getattr(param, "hidden", False):
                assert param.opts[0] in page
        assert "(no description)" not in page


@pytest.mark.skipif(shutil.which("groff") is None, reason="needs groff")
def test_man_pages_are_laid_out_without_a_warning(share: Path):
    for page in (share / "man" / "man1").iterdir():
        command = ["groff", "-man", "-ww", "-Tutf8", "-z", str(page)]
        result = subprocess.run(command, capture_output=True, text=True, check=True)
        assert result.stderr == ""


def test_text_is_escaped_for_roff(command_files: ModuleType):
    assert command_files.escape(".a\n'b\\c-d e.f") == "\\&.a\n\\&'b\\ec\\-d e.f"


def test_bash_completes_commands_with_the_script_of_the_package(share: Path):
    script = share / "bash-completion" / "completions" / "farm"
    command = f". {script} && complete -p farm"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert result.stdout.strip().endswith("_farm_completion farm")
    assert (share / "zsh" / "vendor-completions" / "_farm").read_text().startswith("#compdef farm")


@pytest.mark.parametrize("name", ["preinst", "postinst", "prerm", "postrm"])
def test_maintainer_scripts_stop_at_an_error_and_leave_agents_running(name: str):
    path = DEBIAN / name
    subprocess.run(["sh", "-n", path], check=True)
    text = path.read_text()
    assert text.startswith("#!/bin/sh\n") and "\nset -e\n" in text
    text = re.sub(r"(?m)^ *echo .*$", "", text)
    assert not re.search(r"systemctl [^\n]*farm-agent", text)
    assert not re.search(r"systemctl [^\n]*\benable\b", text)


def test_apt_refuses_another_python_and_another_cura():
    [depends] = re.findall(r"^Depends: (.*)$", (DEBIAN / "control").read_text(), re.MULTILINE)
    for required in ("python3 (<< 3.12)", "cura-engine (>= 1:4.13)", "cura-engine (<< 1:4.14)"):
        assert required in depends


def test_running_agents_of_every_user_are_found():
    """Also find agents of a daemon on another host, because a removal must not delete their program."""
    text = (DEBIAN / "prerm").read_text()
    [function] = re.findall(r"(?ms)^list_agents\(\) \{$.*?^\}$", text)
    python = "/opt/farm/.venv/bin/python"
    command = [python, "-c", "cat", "-m", "drivers.agent", "--folder", "/home/ann/agents/um2-09"]
    script = ["sh", "-c", f"set -e\n{function}\nlist_agents"]
    with subprocess.Popen(command, executable="/bin/sh", stdin=subprocess.PIPE) as agent:
        output = subprocess.run(script, capture_output=True, text=True, check=True).stdout
        agent.communicate()
    assert "--folder /home/ann/agents/um2-09" in output
    assert "um2-09" not in subprocess.run(script, capture_output=True, text=True, check=True).stdout


def test_purge_does_not_remove_a_checkout():
    text = (DEBIAN / "postrm").read_text()
    assert text.index("/opt/farm/.git") < text.index("rm -rf")


def test_script_tests_are_refused_outside_the_copy_of_the_host():
    result = subprocess.run([DEBIAN / "test-scripts.sh", "--in-copy"], capture_output=True, text=True)
    assert (result.returncode, "in the copy only" in result.stderr) == (2, True)


def test_dpkg_runs_the_scripts_of_the_package_with_a_stub_of_systemctl():
    """Install, upgrade, remove and purge a package with a stub program, in a copy of this host's files."""
    result = subprocess.run([DEBIAN / "test-scripts.sh"], capture_output=True, text=True)
    if result.returncode == SKIP_STATUS:
        pytest.skip(result.stderr.strip())
    assert result.returncode == 0, result.stdout + result.stderr


def test_scripts_use_names_that_exist():
    """Import the modules and names that the scripts give to Python; a rename would break the installation."""
    command_texts = [path.read_text(errors="ignore") for path in DEPLOY.rglob("*") if path.is_file()]
    imports = [found for text in command_texts for found in re.findall(r"-c '(from [\w.]+ import \w+)", text)]
    modules = {
        name
        for text in command_texts
        for name in re.findall(r"python\"? -m ((?:farm|drivers|decompose|slicing)[\w.]*)", text, re.I)
    }
    assert "from decompose.jit import INSTALLED_FOLDER" in imports
    assert "drivers.agent" in modules and "decompose.compilation" in modules
    for command in imports:
        exec(command, {})
    for name in modules:
        assert importlib.util.find_spec(name) is not None, name
