"""The console script hands every command to its module."""

import pytest
from helpers.commands import assert_refused

from evaluation import __main__ as command
from isac_track import __version__


@pytest.mark.parametrize(("words", "code"), [(["--help"], 0), ([], 2)])
def test_help_names_every_command_and_none_is_wrong_usage(words, code, ran):
    ended = ran(command, *words)
    assert ended.code == code
    assert all(name in ended.out for name in ("usage: isac-track", *command.COMMANDS))


def test_version(ran):
    assert ran(command, "--version") == (0, f"isac-track {__version__}\n", "")


@pytest.mark.parametrize(
    ("word", "hint"), [("matirx", "did you mean 'matrix'?"), ("zzz", "known: matrix")]
)
def test_an_unknown_command_has_a_hint(word, hint, ran):
    assert_refused(ran(command, word), hint)


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["matrix", "--list"], 0),
        (["matrix", "--seed", "-1"], 2),
        (["report", "/nowhere"], 2),
    ],
)
def test_a_command_gives_its_modules_exit_code(words, code, ran):
    assert ran(command, *words).code == code


@pytest.mark.parametrize("name", command.COMMANDS)
def test_every_command_has_help(name, capsys):
    with pytest.raises(SystemExit) as stop:
        command.main([name, "--help"])
    assert stop.value.code == 0
    assert "usage:" in capsys.readouterr().out
