"""Task for an idle printer whose agent has an older version."""

from pathlib import Path

from books.recording_controller import Farm
from farm.model import Link
from farm.paths import StateFolder
from farm.views import list_tasks


def test_outdated_agent_is_a_task_until_it_is_replaced(tmp_path: Path):
    state = StateFolder(tmp_path / "state")
    state.make()
    farm = Farm(tmp_path)
    farm.report_ready("a", "b")
    assert list_tasks(farm.build_view_context(state)) == []
    reason = "its agent has an older version: replace it with `farm up --replace a`"
    farm.report_ready("a", link=Link.FAULT, outdated=True, reason=reason)
    assert [(item.code, item.text) for item in list_tasks(farm.build_view_context(state))] == [
        ("replace", f"a {reason}")
    ]
    farm.report_ready("a")
    assert list_tasks(farm.build_view_context(state)) == []
