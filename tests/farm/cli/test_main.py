"""Wrong usage of the `farm` command: one line, and exit code 2."""

import pytest

from farm.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["submit"], "Missing argument"),
        (["submit", "x.stl", "--printers", "0"], "of at least 1, or auto; see `farm submit --help`"),
        (["submit", "x.stl", "--engine", "saw"], "--engine': 'saw' is not one of"),
        (["nonsense"], "No such command 'nonsense'"),
        (["history", "--last", "0"], "greater than or equal to 1"),
        (["load", "a", "--wrong"], "No such option: --wrong"),
    ],
)
def test_wrong_usage_gets_one_line(arguments, message, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["farm", *arguments])
    with pytest.raises(SystemExit) as exit_error:
        main()
    output, err = capsys.readouterr()
    assert (exit_error.value.code, output, err.count("\n")) == (2, "", 1)
    assert err.startswith("farm: ") and message in err


def test_commands_are_listed_without_arguments(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["farm"])
    with pytest.raises(SystemExit):
        main()
    output, err = capsys.readouterr()
    assert "submit" in output + err and "farm: " not in err
