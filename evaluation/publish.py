"""Copy a run to be passed on: `isac-track publish OUT`; see docs/how-to/publish.md."""

import shutil
import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from isac_track.command_line import DONE, FAILED_CELLS, Parser, exit_code
from isac_track.errors import DataError, SettingsError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python -m evaluation.publish",
        description=(
            "Copy a finished run without the key of its pseudonyms, without true walks"
            " and without the place of its recording. Tables and page are made anew"
            " from the copied cells."
        ),
    )
    command.add_argument("out", type=Path, help="folder of a run")
    about = "folder of the copy, which must not exist (default: OUT-published)"
    command.add_argument("--to", type=Path, metavar="DIR", help=about)
    return exit_code(lambda: _publish(command.parse_args(arguments)))


def _publish(options: Namespace) -> int:
    from evaluation.api import rebuild  # noqa: PLC0415 - --help answers at once
    from evaluation.store.folder import copy_without_private  # noqa: PLC0415 - as above

    out: Path = options.out
    to = options.to or out.absolute().with_name(f"{out.absolute().name}-published")
    copy_without_private(out, to)
    try:
        results = rebuild(to)
    except (DataError, SettingsError):
        shutil.rmtree(to)  # made by this command a moment ago
        raise
    print(f"Published: {to}; it tells no ids, no true walks and no paths")
    return FAILED_CELLS if len(results.failed) else DONE


if __name__ == "__main__":
    sys.exit(main())
