"""Does a verdict hold under other assumptions? `python -m evaluation.sensitivity OUT`.

Each variant changes a single assumption of a finished run and is a run of its own in
OUT/sensitivity/VARIANT, with the attacks that the verdict is about. OUT/sensitivity.csv
has every item of the verdict in every variant; docs/how-to/sensitivity.md says how to
read it.
"""

import json
import sys
import time
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from evaluation.plan.variants import (
    BASE,
    Variant,
    choose_variants,
    variant_settings,
)
from isac_track.command_line import (
    DONE,
    FAILED_CELLS,
    Parser,
    check_interrupt,
    exit_code,
)
from isac_track.errors import DataError, IsacTrackError, SettingsError

_EPILOG = """\
exit codes: 0 done, 2 wrong usage or data, 3 a variant failed (the others are done), 130 interrupted

examples:
  python -m evaluation.sensitivity runs/students03-paper-0
  python -m evaluation.sensitivity runs/mine --variant law=isotropic --variant epsilon=0.5
  python -m evaluation.sensitivity runs/mine --variant privacy.epsilon_m=0.4 --scenes 100
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python -m evaluation.sensitivity",
        description="Repeat the verdict of a finished run under other assumptions.",
        epilog=_EPILOG,
    )
    add = command.add_argument
    add("out", type=Path, metavar="OUT", nargs="?", help="folder of a finished run")
    about = (
        "of --list, or STAGE.KEY=, law=, epsilon=, predictor=, recording=; replaces"
        " those of --list"
    )
    add("--variant", action="append", metavar="NAME", help=about)
    about = "a class of your own that the run used, package.module:Class; repeatable"
    add("--trust", action="append", default=[], metavar="SPEC", help=about)
    about = "a further variant with this setting; repeatable"
    add("--set", action="append", default=[], metavar="STAGE.KEY=VALUE", help=about)
    add("--list", action="store_true", help="list the variants, and stop")
    add(
        "--scenes",
        type=int,
        metavar="N",
        help="scenes of each variant (default: the run's)",
    )
    add(
        "--jobs",
        type=int,
        metavar="N",
        help="worker processes, as in evaluation.matrix",
    )
    add("--fresh", action="store_true", help="replace earlier runs of the variants")
    add(
        "--json", action="store_true", help="print one JSON object instead of the table"
    )
    interrupted = (
        "interrupted; finished cells stay, the same command continues (without --fresh)"
    )
    return exit_code(
        lambda: _command(command.parse_args(arguments)), interrupted=interrupted
    )


def _command(options: Namespace) -> int:
    manifest = None
    if options.out is not None:
        from evaluation.store.manifest import (  # noqa: PLC0415 - --help answers at once
            read_manifest,
        )
        from evaluation.store.people import with_paths  # noqa: PLC0415 - as above

        manifest = with_paths(options.out, read_manifest(options.out))
    elif not options.list:
        raise SettingsError("name the folder of a finished run (see --help)")
    variants = choose_variants(
        options.variant, stage_values=options.set, manifest=manifest
    )
    if manifest is not None and not options.list:
        return _run(options, variants, manifest)
    width = max(len(variant.name) for variant in variants)
    for variant in variants:
        print(f"{variant.name:<{width}}  {variant.description}")
    return DONE


def _run(
    options: Namespace, variants: Sequence[Variant], manifest: Mapping[str, Any]
) -> int:
    from evaluation.reporting import difference_tables  # noqa: PLC0415 - for --help
    from evaluation.store.csv_files import to_csv  # noqa: PLC0415 - for --help
    from evaluation.store.files import write_whole  # noqa: PLC0415 - for --help
    from evaluation.verdict import sensitivity as verdicts  # noqa: PLC0415 - for --help

    attacks = verdicts.attack_tasks(verdicts.read_verdict(options.out)["items"])
    if manifest.get("state") != "finished":
        raise DataError(
            f"the run in {options.out} is not finished; run the matrix again"
        )
    outcomes: list[dict[str, Any]] = []
    for place, variant in enumerate(variants, start=1):
        print(f"{place} of {len(variants)}: {variant.name}", file=sys.stderr)
        outcome = _run_variant(options, variant, manifest, attacks)
        outcomes.append(outcome)
        for reason in outcome["left_out"]:
            print(f"notice: left out: {reason}", file=sys.stderr)
        why = outcome["why"]
        end = f"failed: {why}" if why else f"done in {outcome['seconds']:.0f} s"
        print(end, file=sys.stderr)
        rows, not_shown = verdicts.collect(options.out)
        write_whole(options.out / verdicts.TABLE, to_csv(rows))
    if options.json:
        content = difference_tables.variants_json(rows, outcomes, out=options.out)
        text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
        print(text, flush=True)
    else:
        difference_tables.show_variants(rows, left_out=not_shown)
    failed = [outcome for outcome in outcomes if outcome["why"]]
    sys.stderr.writelines(
        f"failed: {outcome['name']}: {outcome['why']}\n" for outcome in failed
    )
    return FAILED_CELLS if failed else DONE


def _run_variant(
    options: Namespace,
    variant: Variant,
    manifest: Mapping[str, Any],
    attacks: Mapping[str, frozenset[str]],
) -> dict[str, Any]:
    """Run a variant; return its name, state, failure, duration, and tasks left out.

    Raises IsacTrackError if the base fails: all others are compared with it.
    """
    from evaluation.api import run  # noqa: PLC0415 - for --help
    from evaluation.plan.plan import make_plan  # noqa: PLC0415 - as above
    from evaluation.pool.execute import borrow  # noqa: PLC0415 - for --help
    from evaluation.verdict import sensitivity as verdicts  # noqa: PLC0415 - as above

    started, why = time.monotonic(), ""
    left_out: Sequence[str] = ()
    try:
        settings, left_out = variant_settings(
            variant,
            manifest=manifest,
            attacks=attacks,
            out=verdicts.variant_folder(options.out, variant.name),
            scenes=options.scenes,
            jobs=options.jobs,
            trust=options.trust,
        )
        plan = make_plan(settings)
        sources = options.out, verdicts.variant_folder(options.out, BASE)
        borrow(plan, sources=sources, fresh=options.fresh)
        # `evaluation.report` draws a variant on request.
        run(plan=plan, progress=False, pictures=False)
    except IsacTrackError as error:
        if variant.name == BASE:
            raise
        why = str(error)
    check_interrupt()
    return {
        "name": variant.name,
        "state": "failed" if why else "finished",
        "why": why,
        "seconds": round(time.monotonic() - started, 1),
        "left_out": list(left_out),
    }


if __name__ == "__main__":
    sys.exit(main())
