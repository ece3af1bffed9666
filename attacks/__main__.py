"""``python -m attacks``: list the attacks, check a plug-in, or begin your own."""

import keyword
import re
import shlex
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

from isac_track.command_line import DONE, LIMIT_NOT_MET, Parser, exit_code
from isac_track.errors import IsacTrackError, SettingsError

if TYPE_CHECKING:
    from attacks.testing import CheckResult

_BOARD = {
    "reconstruction": "--attack {name}",
    "mechanism": "--mechanism {name}",
    "policy": "--mechanism raw --policy {name}",
}
"""Options of a board by kind of plug-in; no other kind has a place on it."""
KINDS: dict[str, dict[str, str]] = {
    "reconstruction": {
        "noun": "attack",
        "one_check": "null_stays_at_chance",
        "idea": "smooth",
        "parameter": "tau_s",
        "another": "0.1",
    },
    "linkage": {
        "noun": "attack",
        "one_check": "null_stays_at_chance",
        "idea": "describe",
        "parameter": "bin_s",
        "another": "0.5",
    },
    "mechanism": {
        "noun": "mechanism",
        "one_check": "sigma_is_declared",
        "idea": "how_much",
        "parameter": "d_sigma",
        "another": "0.2",
    },
    "predictor": {
        "noun": "predictor",
        "one_check": "odd_tracks_are_predicted",
        "idea": "ahead",
        "parameter": "window_s",
        "another": "0.5",
    },
    "policy": {
        "noun": "policy",
        "one_check": "form_stays_the_same",
        "idea": "whom",
        "parameter": "metres",
        "another": "3.0",
    },
    "tracker": {
        "noun": "tracker",
        "one_check": "later_scans_do_not_matter",
        "idea": "nearest",
        "parameter": "gate_m",
        "another": "0.8",
        "option": "--set tracking.method=",
    },
}
"""The words that the templates fill in for each kind of plug-in.

`option` names the plug-in in a run, by default `--NOUN +`, which adds to a preset.
"""
_IMPORTED = {
    "ClassVar",
    "Form",
    "Track",
    "Knowledge",
    "Literal",
    "Prediction",
    "Reconstruction",
}
"""Classes that the generated file imports; its own class needs another name."""
_STATUS = {"passed": "pass", "failed": "FAIL", "skipped": "skip"}
_EPILOG = """\
exit codes: 0 done, 1 a check failed, 2 wrong usage, 130 interrupted

examples:
  python -m attacks list
  python -m attacks check kalman_rts
  python -m attacks check my_package.my_module:MyAttack
  python -m attacks new my_attack
  python -m attacks new my_linker --kind linkage
  python -m attacks new my_noise --kind mechanism
  python -m attacks new my_policy --kind policy
  python -m attacks new my_association --kind tracker
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""

    def run() -> int:
        options = vars(parser().parse_args(arguments))
        commands: dict[str, Callable[..., int]] = {
            "check": _check,
            "new": _new,
            "list": _list,
        }
        return commands[options.pop("command")](**options)

    return exit_code(run)


def parser() -> Parser:
    """Return the command line."""
    command = Parser(
        prog="python -m attacks",
        description=(
            "List the attacks; check an attack, mechanism, predictor, policy or tracker"
            " against its kit, or begin your own."
        ),
        epilog=_EPILOG,
    )
    commands = command.add_subparsers(dest="command", title="commands", required=True)
    commands.add_parser(
        "list", help="what is built in or installed, and which adversaries run it"
    )
    check = commands.add_parser("check", help="run its kit on one plug-in")
    check.add_argument(
        "spec",
        metavar="SPEC",
        help="name[:VALUE][,key=value...] or package.module:Class[:...]",
    )
    new = commands.add_parser(
        "new", help="write a package with a plug-in that works, to edit"
    )
    new.add_argument(
        "name", metavar="NAME", help="a lower-case Python identifier: my_attack"
    )
    new.add_argument(
        "--kind",
        choices=KINDS,
        default="reconstruction",
        help=(
            "an attack that asks where people were (default) or whose release it is, or"
            " how positions are shared or predicted, what an answer discloses, or how"
            " detections are joined"
        ),
    )
    new.add_argument(
        "--into",
        type=Path,
        default=Path(),
        metavar="DIR",
        help="where (default: this folder)",
    )
    return command


def _list() -> int:
    from attacks.testing import list_adversaries  # noqa: PLC0415 - `--help` stays quick
    from isac_track import plugins  # noqa: PLC0415 - as above
    from isac_track.protocols import attack_kind  # noqa: PLC0415 - it needs numpy, as above

    lines = [("attack", "kind", "adversaries", "", "")]
    skipped = []
    for name in plugins.names("attacks"):
        try:
            attack = plugins.parse("attacks", name)[0].instance
            adversaries = ", ".join(list_adversaries(attack))
        except IsacTrackError as error:
            skipped.append(f"skipped {name}: {error}")
            continue
        slow = "slow" if getattr(attack, "slow", False) else ""
        summary = (type(attack).__doc__ or "").strip().partition("\n")[0]
        if summary.startswith(f"{type(attack).__name__}("):
            # A dataclass without a docstring gets its signature as docstring.
            summary = ""
        lines.append((name, attack_kind(attack), adversaries, slow, summary))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        padded = zip(line, widths, strict=True)
        print("  ".join(f"{text:<{width}}" for text, width in padded if width).rstrip())
    if skipped:
        print(*skipped, sep="\n", file=sys.stderr)
    return DONE


def _check(spec: str) -> int:
    from attacks.testing import (  # noqa: PLC0415 - `--help` stays quick
        checks_for,
        list_adversaries,
        plugin_noun,
    )
    from isac_track import plugins  # noqa: PLC0415 - as above
    from isac_track.testing import engine  # noqa: PLC0415 - as above

    passed = True
    for plugin in plugins.parse(plugins.find_kind(spec), spec):
        checks, noun = checks_for(plugin.instance), plugin_noun(plugin.instance)
        width = max(map(len, checks))
        role = f"a {noun}"
        if noun == "attack":
            role = ", ".join(list_adversaries(plugin.instance))
        print(f"{plugin.spec} as {role}:")
        passed &= engine.report(
            engine.outcomes(checks.values(), plugin.instance),
            line=partial(_outcome_line, width=width),
        )
    return DONE if passed else LIMIT_NOT_MET


def _outcome_line(outcome: "CheckResult", *, width: int) -> str:
    """Return the line of one check, its name padded to `width` columns."""
    status = _STATUS[outcome.status]
    return f"  {status}  {outcome.name:<{width}}  {outcome.message}"


def _new(name: str, *, kind: str, into: Path) -> int:
    from isac_track.plugins import KIND_BY_NOUN  # noqa: PLC0415 - `--help` stays quick

    class_name, folder = "".join(map(str.capitalize, name.split("_"))), into / name
    noun = KINDS[kind]["noun"]
    option = KINDS[kind].get("option", f"--{noun} +")
    _reject_taken(name, class_name=class_name, folder=folder, noun=noun)
    shown = f"./{name}" if into == Path() else shlex.quote(str(folder))
    commands = {
        "install": f"pip install -e {shown}",
        "pytest": f"pytest {shown.removeprefix('./')}",
        "matrix": f"python -m evaluation.matrix {option}{name}",
    }
    if kind in _BOARD:
        board = _BOARD[kind].format(name=name)
        commands["board"] = f"python -m evaluation.board {board} cards --out board"
    description = f"{kind} attack" if noun == "attack" else noun
    words = KINDS[kind] | commands
    words["group"] = KIND_BY_NOUN[noun]
    words |= {"is": description, "name": name, "class_name": class_name}
    words["option"] = option
    words["beside"] = _beside(noun, name)
    words["on_board"] = ""
    if "board" in commands:
        words["on_board"] = (
            "\n- On a board of cards (`python -m evaluation.card --out cards` makes"
            f" them): `{commands['board']}`"
        )
    sources = {
        f"{name}.py": f"{kind}.py",
        f"test_{name}.py": "test_plugin.py",
        "pyproject.toml": "pyproject.toml",
        "README.md": "README.md",
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for target, source in sources.items():
            template = files("attacks") / "templates" / f"{source}.tmpl"
            text = Template(template.read_text(encoding="utf-8")).substitute(words)
            (folder / target).write_text(text, encoding="utf-8")
    except OSError as error:
        raise SettingsError(
            f"cannot write {error.filename}: {error.strerror}"
        ) from error
    works = f"{_with_article(noun)} that works; edit {folder / name}.py, then:"
    print(f"wrote {folder}: {works}", *commands.values(), sep="\n  ")
    return DONE


def _beside(noun: str, name: str) -> str:
    """Return how a plug-in stands beside the built-in plug-ins in a run."""
    if noun == "tracker":
        return "stands beside perfect association."
    return (
        "stands beside the built-in plug-ins: `+` adds to them, without it"
        f" `{name}` replaces them."
    )


def _with_article(noun: str) -> str:
    return f"an {noun}" if noun == "attack" else f"a {noun}"


def _reject_taken(name: str, *, class_name: str, folder: Path, noun: str) -> None:
    """Raise SettingsError for a name that clashes or that Python cannot import."""
    from isac_track import plugins  # noqa: PLC0415 - `--help` stays quick

    wrong, way_out = "", "take another name"
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        wrong, way_out = "must be a lower-case Python identifier, as my_attack is", ""
        better = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").lower()
        if better[:1].isalpha() and better != name:
            way_out = f"did you mean {better!r}?"
    elif keyword.iskeyword(name) or keyword.iskeyword(class_name):
        wrong = "is a word of Python itself"
    elif class_name in _IMPORTED:
        wrong = f"would call its class {class_name}, which is taken"
    elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise SettingsError(
            f"{folder} is there already; take another name, or --into DIR"
        )
    elif name in plugins.names(plugins.KIND_BY_NOUN[noun]):
        wrong = f"is the name of {_with_article(noun)} already"
    # A folder without a module, such as an empty folder of that name, does no harm.
    elif (
        name in sys.stdlib_module_names
        or getattr(find_spec(name), "origin", None) is not None
    ):
        wrong = "is the name of a Python module already"
    if wrong:
        raise SettingsError(f"{name!r} {wrong}; {way_out}".removesuffix("; "))


if __name__ == "__main__":
    sys.exit(main())
