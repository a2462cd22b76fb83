"""Tests of the check of commit subjects (`.ci/commit-subjects`) in small repositories."""

import re
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / ".ci" / "commit-subjects"
LONG_SUBJECT = "x" * 73


class Repository:
    """A git repository that contains the script."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.script = folder / ".ci" / "commit-subjects"

    def run_git(self, *arguments: str) -> str:
        command = ["git", "-c", "user.name=a", "-c", "user.email=a@b", *arguments]
        result = subprocess.run(command, cwd=self.folder, check=True, capture_output=True, text=True)
        return result.stdout.strip()

    def commit(self, subject: str) -> str:
        self.run_git("commit", "--quiet", "--allow-empty", "--no-verify", "-m", subject)
        return self.run_git("rev-parse", "HEAD")

    def check(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        command = [self.script, *arguments]
        return subprocess.run(command, cwd="/", check=False, capture_output=True, text=True)

    def set_base(self, commit: str) -> None:
        text = SCRIPT.read_text()
        self.script.parent.mkdir(exist_ok=True)
        self.script.write_text(re.sub(r"^BASE=\w+", f"BASE={commit}", text, flags=re.M))
        self.script.chmod(0o700)


@pytest.fixture
def repository(tmp_path: Path) -> Repository:
    folder = tmp_path / "work"
    folder.mkdir()
    new_repository = Repository(folder)
    new_repository.run_git("init", "--quiet")
    new_repository.set_base(new_repository.commit("before the rule: " + LONG_SUBJECT))
    return new_repository


def test_subject_of_72_characters_passes(repository: Repository):
    repository.commit("ü" * 72)
    assert repository.check().returncode == 0


@pytest.mark.parametrize("subject", [LONG_SUBJECT, "Ends with a period."])
def test_bad_subject_is_refused_and_named(repository: Repository, subject: str):
    commit = repository.commit(subject)
    repository.commit("Good")
    result = repository.check()
    assert result.returncode == 1
    assert commit[:9] in result.stderr and subject in result.stderr


def test_shallow_clone_without_the_base_is_checked(repository: Repository, tmp_path: Path):
    base = repository.run_git("rev-parse", "HEAD")
    repository.commit("One")
    repository.commit("Two")
    clone = Repository(tmp_path / "clone")
    repository.run_git("clone", "--quiet", "--depth", "1", f"file://{repository.folder}", str(clone.folder))
    clone.set_base(base)
    assert clone.check().returncode == 0
    clone.commit(LONG_SUBJECT)
    assert clone.check().returncode == 1


def test_folder_without_git_passes(tmp_path: Path):
    plain_folder = Repository(tmp_path)
    plain_folder.set_base("0" * 40)
    assert plain_folder.check().returncode == 0


@pytest.mark.parametrize(
    ("message", "code"),
    [("# help\n\nGood\n\nwhy\n", 0), (f"{LONG_SUBJECT}\n", 1), ("# only help\n", 0)],
    ids=["good", "long", "empty"],
)
def test_hook_reads_the_subject_of_a_message(repository: Repository, tmp_path: Path, message: str, code: int):
    file = tmp_path / "message"
    file.write_text(message)
    assert repository.check("--file", str(file)).returncode == code
