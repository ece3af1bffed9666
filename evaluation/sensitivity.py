"""Does a verdict hold under other assumptions? `python -m evaluation.sensitivity OUT`.

Each variant changes one assumption of a finished run (error law, epsilon, constants, recording,
predictor) and is a run of its own in OUT/sensitivity/VARIANT, with the attacks that the verdict is
about. OUT/sensitivity.csv holds what becomes of every item; docs/sensitivity.md says how to read
it.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evaluation.experiment.variants import BASE, Variant, parse, stages_of, variants
from evaluation.reporting.sensitivity_table import (
    TABLE,
    collect,
    counts,
    folder_of,
    read_verdict,
    show,
    turned,
)
from isac_track.command_line import Parser, check_interrupt, exit_code
from isac_track.errors import DataError, IsacTrackError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import pandas as pd

    from evaluation.experiment.plan import Plan
    from evaluation.experiment.settings import Settings
    from isac_track.config import StageSettings
    from isac_track.plugins import Kind
    from isac_track.types import Tracks

_EXIT = """\
exit codes: 0 done, 2 wrong usage or data, 3 a variant failed (the others are done), 130 interrupted

examples:
  python -m evaluation.sensitivity runs/students03-paper-0
  python -m evaluation.sensitivity runs/mine --variant law=isotropic --variant epsilon=0.5
  python -m evaluation.sensitivity runs/mine --variant privacy.epsilon_m=0.4 --scenes 100
"""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a variant that was asked for."""

    name: str
    seconds: float
    why: str = ""
    """Why it failed; empty if it did not."""
    left_out: tuple[str, ...] = ()
    """Tasks that its recording is too small for, and why."""


def attacks_of(items: Iterable[Mapping[str, Any]]) -> dict[str, frozenset[str]]:
    """Return the SPECs of the attacks that a verdict is about, each with its tasks.

    Those are the subjects of its items, and of the contrasts in which a mechanism differs from
    fixed noise. A reconstruction has the task "".

    Parameters
    ----------
    items : iterable of mapping
        As in `verdict.json`.
    """
    found: dict[str, set[str]] = {}
    for one in items:
        contrasts = [pair for pair in one.get("contrasts", ()) if pair["reading"] == "differs"]
        for subject in (one["subject"], *(pair.get("subject", "") for pair in contrasts)):
            if subject:
                found.setdefault(subject.rpartition(" (")[0], set()).add(one["task"])
    return {spec: frozenset(tasks) for spec, tasks in found.items()}


def settings_of(
    variant: Variant,
    *,
    manifest: Mapping[str, Any],
    verdict: Mapping[str, Any],
    out: Path,
    scenes: int | None = None,
    jobs: int | None = None,
    trust: Sequence[str] = (),
) -> tuple[Settings, tuple[str, ...]]:
    """Return the settings of a variant's run, and the tasks that are left out, each with why.

    Parameters
    ----------
    variant : Variant
    manifest, verdict : mapping
        Of the run, as in its files.
    out : Path
        Folder of the variant.
    scenes, jobs : int, optional
        Instead of the run's scenes and of the default number of workers.
    trust : sequence of str
        SPECs of classes of one's own that may be imported although a file names them.

    Raises
    ------
    IsacTrackError
        If its recording is not at hand, or a setting is unknown.
    """
    from evaluation.experiment.settings import Settings  # noqa: PLC0415 - --help and --list answer at once
    from isac_track import datasets  # noqa: PLC0415
    from isac_track.datasets.registry import KNOWN  # noqa: PLC0415

    ran = manifest["settings"]
    stages = stages_of(manifest).changed(variant.stages)
    name, own = manifest["dataset"]["name"], {"format": None, "fps": None}
    source = name
    if variant.recording:
        source = variant.recording
    elif name not in KNOWN:
        source = manifest["dataset"]["path"]
        own = {"format": manifest["dataset"]["format"], "fps": manifest["identity"]["fps"]}
    # Nobody waits for a network here: a data set that is missing fails with how to get it.
    data = datasets.load(source, download=False, **own)
    if not variant.recording and data.sha256 != manifest["dataset"]["sha256"]:
        raise DataError(f"{data.path} is no longer the recording that was run; run it again")
    attacks = attacks_of(verdict["items"])
    asked = {task for tasks in attacks.values() for task in tasks} - {""}
    left_out = _too_small(asked, tracks=data.tracks, stages=stages, seed=ran["seed"])
    ran_predictor = () if variant.predictor else tuple(ran["predictors"][:1])
    _refuse_own_classes("mechanisms", ran["mechanisms"], trust=trust)
    _refuse_own_classes("predictors", ran_predictor, trust=trust)
    _refuse_own_classes("attacks", attacks, trust=trust)
    kept = (asked - left_out.keys()) | {""}
    predictor = (variant.predictor,) if variant.predictor else ran_predictor
    return (
        Settings(
            preset=ran["preset"],
            dataset=source,
            format=own["format"],
            fps=own["fps"],
            scenes=ran["scenes"] if scenes is None else scenes,
            seed=ran["seed"],
            mechanisms=tuple(ran["mechanisms"]),
            predictors=predictor,
            attacks=tuple(spec for spec, tasks in sorted(attacks.items()) if tasks & kept),
            tasks=tuple(task for task in ran["tasks"] if task in kept),
            stages=stages,
            jobs=jobs,
            out=out,
        ),
        tuple(left_out.values()),
    )


def _refuse_own_classes(kind: Kind, specs: Iterable[str], *, trust: Sequence[str]) -> None:
    """Let only the user's own command line decide what is imported, never a file."""
    from isac_track import plugins as registry  # noqa: PLC0415 - as above

    for spec in (part for whole in specs for part in whole.split("@")):
        if registry.is_own_class(kind, spec) and spec not in trust:
            raise SettingsError(
                f"the run's files name {spec!r}, a class that is not built in; "
                f"if it is yours, say so: --trust {spec}"
            )


def _too_small(
    tasks: Iterable[str], *, tracks: Tracks, stages: StageSettings, seed: int
) -> dict[str, str]:
    """Return the tasks that a recording has too few people for, each with why."""
    from attacks.tasks.build import sessions_of  # noqa: PLC0415
    from attacks.tasks.task_list import TASKS  # noqa: PLC0415 - as above

    found = {}
    for name in sorted(tasks):
        try:
            sessions_of(TASKS[name], tracks=tracks, stages=stages, seed=seed)
        except DataError as error:
            found[name] = str(error)
    return found


def run_variant(settings: Settings, *, sources: Sequence[Path], fresh: bool) -> None:
    """Run a variant, or what of it is missing.

    Parameters
    ----------
    settings : Settings
        With the folder of the variant as `out`.
    sources : sequence of Path
        Folders of other runs: a cell that one of them has is taken from there.
    fresh : bool
        Replace what is in the folder.

    Raises
    ------
    IsacTrackError
        For anything that a user can mend; finished cells are kept.
    """
    from evaluation.experiment.plan import plan  # noqa: PLC0415 - as above
    from evaluation.results import run  # noqa: PLC0415

    ready = plan(settings)
    _borrow(ready, sources=sources, fresh=fresh)
    run(ready=ready, pictures=False)  # `evaluation.report` draws those that matter


def _borrow(ready: Plan, *, sources: Sequence[Path], fresh: bool) -> None:
    """Open the folder of a run and copy the cells into it that other runs have.

    A cell's name is keyed by all that its rows depend on: those of one name are the same.
    """
    from evaluation.runs import folder as store  # noqa: PLC0415 - as above
    from evaluation.runs.cell_files import adopt, sound_cells  # noqa: PLC0415
    from evaluation.runs.lock import locked  # noqa: PLC0415

    store.check_folder(ready.out)
    with locked(ready.out):
        manifest = store.open_run(ready.out, identity=ready.identity, code=ready.code, fresh=fresh)
        store.write_manifest(ready.out, manifest | {"code": ready.code, "state": "running"})
        names = [name for _, _, names in ready.cells for name in names]
        sound, _ = sound_cells(ready.out, names)
        adopt(ready.out, [name for name in names if name not in sound], sources=sources)


def to_json(rows: pd.DataFrame, outcomes: Sequence[Outcome], *, out: Path) -> dict[str, Any]:
    """Return the table as one object of plain values; what is unknown is None."""
    return {
        "out": str(out),
        "variants": [
            {
                "name": one.name,
                "state": "failed" if one.why else "finished",
                "why": one.why,
                "seconds": round(one.seconds, 1),
                "left_out": list(one.left_out),
            }
            for one in outcomes
        ],
        "counts": counts(rows),
        "changed_sign": turned(rows),
        "items": [
            {
                name: None if isinstance(value, float) and math.isnan(value) else value
                for name, value in row.items()
            }
            for row in rows.astype(object).to_dict("records")
        ],
    }


def _parser() -> argparse.ArgumentParser:
    command = Parser(
        prog="python -m evaluation.sensitivity",
        description="Repeat the verdict of a finished run under other assumptions.",
        epilog=_EXIT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = command.add_argument
    add("out", type=Path, metavar="OUT", nargs="?", help="folder of a finished run")
    add(
        "--variant",
        action="append",
        metavar="NAME",
        help="a variant of --list, or STAGE.KEY=VALUE, law=LAW, epsilon=METRES, predictor=SPEC, "
        "recording=NAME|PATH; repeatable; replaces the list",
    )
    add(
        "--trust",
        action="append",
        default=[],
        metavar="SPEC",
        help="a class of your own that the run used, package.module:Class; repeatable",
    )
    add(
        "--set",
        action="append",
        metavar="STAGE.KEY=VALUE",
        default=[],
        help="one more variant: this setting changed; repeatable; adds to the list",
    )
    add("--list", action="store_true", help="list the variants, and stop")
    add("--scenes", type=int, metavar="N", help="scenes of each variant (default: the run's)")
    add("--jobs", type=int, metavar="N", help="worker processes, as in evaluation.matrix")
    add("--fresh", action="store_true", help="replace the runs of the variants, do not continue")
    add("--json", action="store_true", help="print one JSON object instead of the table")
    return command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    return exit_code(
        lambda: _run(_parser().parse_args(arguments)),
        interrupted="interrupted; finished cells are kept, the same command continues "
        "(without --fresh)",
    )


def _run(options: argparse.Namespace) -> int:
    manifest = None
    if options.out is not None:
        from evaluation.runs.folder import read_manifest  # noqa: PLC0415 - as above

        manifest = read_manifest(options.out)
    elif not options.list:
        raise SettingsError("name the folder of a finished run (see --help)")
    chosen = _chosen(options, manifest)
    if manifest is None or options.list:
        width = max(len(one.name) for one in chosen)
        for one in chosen:
            print(f"{one.name:<{width}}  {one.about}")
        return 0
    verdict = read_verdict(options.out)
    if manifest.get("state") != "finished":
        raise DataError(f"the run in {options.out} is not finished; run the matrix again")
    outcomes = []
    for place, variant in enumerate(chosen, start=1):
        print(f"{place} of {len(chosen)}: {variant.name}", file=sys.stderr)
        outcome = _attempt(variant, options=options, manifest=manifest, verdict=verdict)
        check_interrupt()
        outcomes.append(outcome)
        for why in outcome.left_out:
            print(f"notice: left out: {why}", file=sys.stderr)
        print(
            f"failed: {outcome.why}" if outcome.why else f"done in {outcome.seconds:.0f} s",
            file=sys.stderr,
        )
        rows, left_out = _write(options.out)
    if options.json:
        said = to_json(rows, outcomes, out=options.out)
        print(json.dumps(said, indent=1, ensure_ascii=False, allow_nan=False), flush=True)
    else:
        print()
        show(rows, left_out=left_out)
    failed = [outcome for outcome in outcomes if outcome.why]
    for outcome in failed:
        print(f"failed: {outcome.name}: {outcome.why}", file=sys.stderr)
    return 3 if failed else 0


def _chosen(options: argparse.Namespace, manifest: Mapping[str, Any] | None) -> list[Variant]:
    """Return the variants to run, each once, the base first."""
    added = [parse(text) for text in options.set]
    for text, one in zip(options.set, added, strict=True):
        if not one.stages:
            raise SettingsError(f"--set takes STAGE.KEY=VALUE, got {text!r}")
    named = variants(manifest)
    if options.variant is not None:
        named = [Variant(BASE), *(parse(text) for text in options.variant)]
    chosen = {one.name: one for one in (*named, *added)}
    for one in chosen.values():
        if manifest is not None and one.changes_nothing(manifest):
            raise SettingsError(f"{one.name} changes nothing: it is what the run did")
    return list(chosen.values())


def _attempt(
    variant: Variant,
    *,
    options: argparse.Namespace,
    manifest: Mapping[str, Any],
    verdict: Mapping[str, Any],
) -> Outcome:
    """Run a variant; without the base nothing can be said, every other one may fail."""
    started = time.monotonic()
    left_out: tuple[str, ...] = ()
    why = ""
    try:
        settings, left_out = settings_of(
            variant,
            manifest=manifest,
            verdict=verdict,
            out=folder_of(options.out, variant.name),
            scenes=options.scenes,
            jobs=options.jobs,
            trust=options.trust,
        )
        run_variant(
            settings,
            sources=(options.out, folder_of(options.out, BASE)),
            fresh=options.fresh,
        )
    except IsacTrackError as error:
        if variant.name == BASE:
            raise
        why = str(error)
    return Outcome(variant.name, time.monotonic() - started, why, left_out)


def _write(out: Path) -> tuple[pd.DataFrame, dict[str, str]]:
    from evaluation.runs.files import write_whole  # noqa: PLC0415 - as above

    rows, left_out = collect(out)
    write_whole(out / TABLE, rows.to_csv(index=False).encode())
    return rows, left_out


if __name__ == "__main__":
    sys.exit(main())
