"""``python -m isac_track.testing package.module:OBJECT``: one line per check.

Exit code 0: all passed; 1: a check failed; 2: wrong usage.
"""

import sys
from pkgutil import resolve_name

from isac_track.command_line import DONE, LIMIT_NOT_MET, Parser, exit_code
from isac_track.errors import PluginError, SettingsError, error_text
from isac_track.testing import CHECKS, Metrics, run_checks, select_checks
from isac_track.testing.engine import report


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(
        prog="python -m isac_track.testing",
        description=(
            "Check an implementation of PLR, AEL, MEL and the conflict metrics."
        ),
        epilog="This project's own functions: isac_track.testing:OWN",
    )
    parser.add_argument(
        "target",
        nargs="?",
        metavar="package.module:OBJECT",
        help="an isac_track.testing.Metrics",
    )
    parser.add_argument(
        "--check",
        action="append",
        metavar="NAME",
        help="run only this check (repeatable)",
    )
    parser.add_argument("--list", action="store_true", help="name all checks and exit")

    def run() -> int:
        options = parser.parse_args(arguments)
        if options.list:
            for check in CHECKS:
                print(f"{check.name:38} {check.statement}")
            return DONE
        if options.target is None:
            raise SettingsError("name the functions to check: package.module:OBJECT")
        try:
            metrics = resolve_name(options.target)
        except (Exception, SystemExit) as error:
            # The import of somebody else's module may raise anything.
            expected = (
                f"cannot import {options.target!r}, expected package.module:OBJECT"
            )
            raise PluginError(f"{expected}: {error_text(error)}") from error
        if not isinstance(metrics, Metrics):
            got = type(metrics).__name__
            raise PluginError(
                f"{options.target} must be an isac_track.testing.Metrics, got {got}"
            )
        if all(check.missing(metrics) for check in select_checks(options.check)):
            raise SettingsError(
                f"{options.target} offers no function for the checks chosen"
            )
        outcomes = run_checks(metrics, names=options.check)
        shown = "{outcome.status:8}{outcome.name}: {outcome.message}"
        none_failed = report(
            outcomes,
            line=lambda outcome: shown.format(outcome=outcome).removesuffix(": "),
        )
        return DONE if none_failed else LIMIT_NOT_MET

    return exit_code(run)


if __name__ == "__main__":
    sys.exit(main())
