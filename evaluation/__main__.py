"""`isac-track COMMAND ...`: the same as ``python -m`` of the command's module.

A user's own folder called ``evaluation`` would shadow ``python -m evaluation.matrix``.
"""

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from isac_track import __version__
from isac_track.errors import did_you_mean

COMMANDS = {
    "matrix": ("evaluation.matrix", "run the evaluation matrix"),
    "report": ("evaluation.report", "redraw tables and figures of a run"),
    "compare": ("evaluation.compare", "put two runs side by side"),
    "design": (
        "evaluation.design",
        "choose a level that meets a target, with yes or no",
    ),
    "board": ("evaluation.board", "a page of cards; new attacks and mechanisms on it"),
    "card": ("evaluation.card", "score mechanisms, a card each; verify a card"),
    "publish": (
        "evaluation.publish",
        "copy a run without ids' key, true walks and paths",
    ),
    "sensitivity": (
        "evaluation.sensitivity",
        "repeat a run's verdict under other assumptions",
    ),
    "study": ("evaluation.study", "answer several recordings together"),
    "datasets": ("isac_track.datasets.__main__", "list and fetch data sets"),
    "attacks": ("attacks.__main__", "list, check and begin attacks"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return its exit code."""
    words = list((sys.argv or [])[1:] if arguments is None else arguments)
    if not words or words[0] in ("-h", "--help"):
        print("usage: isac-track COMMAND [OPTIONS]\n")
        for name, (_, about) in COMMANDS.items():
            print(f"  {name:<11} {about}")
        print("\nisac-track COMMAND --help describes a command; isac-track --version")
        return 0 if words else 2
    if words[0] == "--version":
        print(f"isac-track {__version__}")
        return 0
    if words[0] not in COMMANDS:
        hint = (
            did_you_mean(words[0], COMMANDS, quote="'")
            or f"; known: {', '.join(COMMANDS)}"
        )
        print(f"error: unknown command {words[0]!r}{hint}", file=sys.stderr)
        return 2
    # As with `python -m`, a plug-in may lie in the working folder; at the end of the
    # path it hides no package.
    sys.path.append(str(Path.cwd()))
    module = import_module(COMMANDS[words[0]][0])
    code: int = module.main(words[1:])
    return code


if __name__ == "__main__":
    sys.exit(main())
