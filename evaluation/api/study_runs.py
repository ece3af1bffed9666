"""Several runs answered as a single study."""

import sys
from collections.abc import Sequence
from pathlib import Path

from evaluation.api.running import load_finished, run
from evaluation.estimates.pooled import Answered, answered, run_answers, to_frame
from evaluation.plan.plan import Plan, make_plan
from evaluation.plan.settings import Settings
from evaluation.reporting import study_page
from evaluation.store.csv_files import to_csv
from evaluation.store.files import write_whole
from isac_track.datasets import Dataset
from isac_track.errors import SettingsError


def study(
    asked: Sequence[tuple[str, Settings]], *, out: Path
) -> tuple[list[Answered], int]:
    """Do the unfinished runs, answer all as one, write `study.csv` and `study.html`.

    `asked` are the error law and the settings of each run, whose folder is in `out`.
    Returns the answers, and the number of failed cells. Raises IsacTrackError for
    anything that a user can mend.
    """
    plans, datasets = list[tuple[str, Plan]](), dict[str | None, Dataset]()
    # All are checked before the first run, and each recording is read once.
    for law, settings in asked:
        plan = make_plan(settings, dataset=datasets.get(settings.dataset))
        plans.append((law, plan))
        datasets[settings.dataset] = plan.dataset
    _refuse_copies([plan for _, plan in plans])
    rows, simulated, n_failed = [], frozenset[str](), 0
    for law, plan in plans:
        if results := load_finished(plan):
            sys.stderr.write(f"{plan.out}: finished before\n")
        else:
            results = run(plan=plan)
        rows += run_answers(results.out, results.manifest, results.verdict, law=law)
        n_failed += len(results.failed)
        if results.manifest["dataset"].get("simulated"):
            simulated |= {results.dataset}
    pooled = answered(rows, simulated=simulated)
    write_whole(out / "study.csv", to_csv(to_frame(rows, pooled)))
    html = study_page.render(
        pooled, simulated=simulated, runs=[plan.out.name for _, plan in plans]
    )
    write_whole(out / "study.html", html.encode())
    return pooled, n_failed


def _refuse_copies(plans: Sequence[Plan]) -> None:
    """Raise SettingsError if two recordings of a study are the same bytes."""
    name_by_digest: dict[str, str] = {}
    for plan in plans:
        name = str(plan.settings.dataset)
        first = name_by_digest.setdefault(plan.dataset.sha256, name)
        if first != name:
            raise SettingsError(
                f"{first} and {name} hold the same bytes: one recording twice is not"
                " two; leave out one, or give --seed twice for further draws of one"
                " recording"
            )
