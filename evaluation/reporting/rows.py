"""A finished run as data frames, and selections of levels and readers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from attacks.tasks.task_list import RETURNS
from evaluation.estimates.families import (
    ADDING_RULES,
    LEVEL_UNITS,
    Family,
    entry_families,
    families_in,
)
from evaluation.estimates.metrics import METRICS, MISSED_RATE
from evaluation.plan.address import (
    Address,
    MechanismLevel,
    is_track_release,
    parse_consumer,
    parse_dataset,
)
from evaluation.plan.presets import SHARED
from evaluation.reporting.announcements import scenes_text
from evaluation.reporting.lookups import ENDS, MAIN_LEVELS, estimates, find_family
from evaluation.reporting.schemes import CONTROL_FAMILIES
from evaluation.reporting.table import Column, level_cell, text_column
from isac_track.errors import SettingsError, did_you_mean

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from evaluation.estimates.linkability import TaskOutcomes
    from evaluation.reporting.headline import Headline
    from evaluation.reporting.table import Table
    from evaluation.verdict.question import Question
    from evaluation.verdict.what_to_share import Recommendation
    from isac_track.intervals import Estimate

STRONGEST: Final = "strongest"
# Suffix of the name of a descriptor after the strongest attack.
AFTER: Final = "_after"
SHORT: Final = {"missed": MISSED_RATE, "false_alarm": "false_alarm_rate"}
"""Metrics by a name that is quick to type."""


@dataclass(frozen=True, eq=False, repr=False)
class Results:
    """A finished run as data frames; the columns are those of the files in `out`.

    Attributes
    ----------
    out : Path
        Run folder.
    manifest : dict
        Settings, versions and data of the run, and its cells: `manifest.json`.
    summary : DataFrame
        Every metric with its interval: `summary.csv`.
    paper_table : DataFrame
        Numbers of the paper beside ours: `paper_table.csv`.
    claims : DataFrame
        Claims of the paper, and what the run says of them: `paper_claims.csv`.
    matched : DataFrame
        Mechanisms at equal cost or equal PLR: `matched.csv`.
    frontier : DataFrame
        Privacy at a target of utility: `frontier.csv`.
    levels : DataFrame
        Privacy and cost at each level that a site could choose: `levels.csv`.
    decisions : DataFrame
        Misses of each predictor at equal false alarms: `decisions.csv`.
    curves : DataFrame
        Misses over false alarms: `curves.csv`.
    flags : DataFrame
        Attacks that are weaker than they should be: `flags.json`.
    linkability : DataFrame
        Outcome of every linkage attack: `linkability.csv`.
    galleries : DataFrame
        Rank 1 and expected rank over the number of candidates: `gallery.csv`.
    speeds : DataFrame
        PLR over net speed: `by_speed.csv`.
    verdict : dict
        Decisions of the run: `verdict.json`.
    failed : DataFrame
        Cells that could not be computed, and why: `failed.csv`. No other table holds
        them.
    strongest : mapping
        By linkage task the attack of the verdict; under ``""`` that of reconstruction.
    conflict_times : DataFrame
        Share of conflicts in which an agent is inside by a time, at every horizon:
        `conflict_times.csv`.
    attacked : DataFrame
        The strongest attack against each mechanism, cross-fitted: `strongest.csv`.
    make_first_table : callable or None
        Makes the table of the first screen, for a notebook.
    gallery : DataFrame or None
        A few walks to be drawn: `gallery.parquet`. None without them, and always after
        `load`.
    """

    out: Path
    manifest: dict[str, Any]
    summary: pd.DataFrame
    paper_table: pd.DataFrame
    claims: pd.DataFrame
    matched: pd.DataFrame
    frontier: pd.DataFrame
    levels: pd.DataFrame
    decisions: pd.DataFrame
    curves: pd.DataFrame
    flags: pd.DataFrame
    linkability: pd.DataFrame
    galleries: pd.DataFrame
    speeds: pd.DataFrame
    verdict: dict[str, Any]
    failed: pd.DataFrame
    strongest: Mapping[str, Address] = field(default_factory=dict)
    conflict_times: pd.DataFrame = field(default_factory=pd.DataFrame)
    attacked: pd.DataFrame = field(default_factory=pd.DataFrame)
    make_first_table: Callable[[Results], Table] | None = None
    gallery: pd.DataFrame | None = None

    @property
    def measured(self) -> pd.DataFrame:
        """The summary without worlds, such as another error law.

        The data sets of worlds are named `DATASET:WORLD`.
        """
        rows = self.without_policy
        is_elsewhere = [
            name != self.dataset and bool(parse_dataset(name).world)
            for name in rows["dataset"]
        ]
        return rows[~np.array(is_elsewhere, dtype=bool)]

    @property
    def without_policy(self) -> pd.DataFrame:
        """The summary of scenes and windows: no patrols, no people who come back.

        Rows of patrols have a disclosure policy, and those of tracks a release.
        """
        return self.summary[~(self._has_policy | self._is_return)]

    @property
    def patrols(self) -> pd.DataFrame:
        """The rows of the summary that are about disclosure policies of patrols."""
        return self.summary[self._has_policy & ~self._is_tracked]

    @property
    def returns(self) -> pd.DataFrame:
        """The rows of the summary that are about people who come back."""
        return self.summary[self._is_return]

    @property
    def has_scenes(self) -> bool:
        """Whether the run has scenes; else it is about people who come back alone."""
        return not self.manifest.get("no_scenes")

    @property
    def _is_return(self) -> pd.Series[bool]:
        """Which rows of the summary are of the task of people who come back."""
        return self.summary["consumer"].str.startswith(f"{RETURNS.name}/")

    @property
    def tracks(self) -> pd.DataFrame:
        """The rows of the summary that are about tracks of a network's detections."""
        return self.summary[self._is_tracked]

    @property
    def _is_tracked(self) -> pd.Series[bool]:
        """Which rows of the summary are of a release of tracks."""
        if "policy" not in self.summary:
            return self._has_policy
        texts = self.summary["policy"]
        known = [text for text in texts.unique() if isinstance(text, str)]
        return texts.isin([text for text in known if is_track_release(text)])

    @property
    def _has_policy(self) -> pd.Series[bool]:
        """Which rows of the summary have a policy; none if it has no such column."""
        if "policy" not in self.summary:
            return pd.Series(data=False, index=self.summary.index)
        return self.summary["policy"].notna() & (self.summary["policy"] != "")

    def __repr__(self) -> str:
        """Return the title of the run, and the table of the first screen in lines."""
        from evaluation.reporting.terminal import aligned  # noqa: PLC0415 - see `load`

        table = self.make_first_table(self) if self.make_first_table else None
        rows = [[cell.full for cell in row] for row in table.rows] if table else []
        heads = [column.head for column in table.columns] if table else []
        lines = aligned([heads, *rows], left={0}) if rows else []
        return "\n".join([f"<{self._title()}>", *lines])

    def _repr_html_(self) -> str:
        """Return the table of the first screen, and the sentences below it."""
        table = self.make_first_table(self) if self.make_first_table else None
        columns, records = (table.columns, table.rows) if table else ([], [])
        heads = "".join(f"<th>{escape(column.head)}</th>" for column in columns)
        rows = "".join(
            f"<tr>{''.join(f'<td>{escape(cell.full)}</td>' for cell in row)}</tr>"
            for row in records
        )
        grid = f"<table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"
        sentences = "".join(
            f"<li>{escape(str(sentence))}</li>"
            for sentence in self.verdict.get("answer", ())
        )
        title = f"<p>{escape(self._title())}</p>"
        return f"{title}{grid if rows else ''}<ul>{sentences}</ul>"

    def _title(self) -> str:
        """Return folder, data set and size of the run, in a line."""
        identity, people = self.manifest["identity"], self.dataset
        if self.manifest["dataset"].get("simulated"):
            people += " (simulated people)"
        shared = self.ours[self.ours["consumer"] == SHARED]
        n_levels = len(shared[["mechanism", "level"]].drop_duplicates())
        failed = f", {len(self.failed)} cells failed" if len(self.failed) else ""
        n_scenes = scenes_text(identity)
        if not self.has_scenes:
            n_scenes = "no scenes"
            n_levels = len(self.returns[["mechanism", "level"]].drop_duplicates())
        size = f"{n_scenes}, seed {identity['seed']}, {n_levels} levels"
        return f"Results {self.out}: {people}, {size}{failed}"

    def recommendation(self, question: Question | None = None) -> Recommendation:
        """Return which levels may be shared, by default as the first screen asks.

        `evaluation.design` gives the same answer: the levels that hold, the cost of
        each, and the adversaries that break it.
        """
        from evaluation.verdict.level_checks import scene_counts  # noqa: PLC0415 - see `load`
        from evaluation.verdict.what_to_share import recommend  # noqa: PLC0415 - see `load`

        if question is None:
            return self._usual_recommendation
        scenes = scene_counts(self.manifest)
        return recommend(self.levels, question, dataset=self.dataset, scenes=scenes)

    @cached_property
    def _usual_recommendation(self) -> Recommendation:
        """The answer to the question of the first screen.

        Cached, as a report reads it about twenty times. It lives as long as these
        results do, like the other cached properties.
        """
        from evaluation.verdict.question import default_question  # noqa: PLC0415 - see `load`

        return self.recommendation(default_question(self.families))

    def frame(
        self, metric: str, *, after: str = "", task: str = "", robot: str = ""
    ) -> pd.DataFrame:
        """Return a metric at every level, as a frame.

        Its columns are family, level, adding, attack, knowledge, value, ci_low and
        ci_high.

        Parameters
        ----------
        metric : str
            As in `summary.csv`, in its unit; `missed` and `false_alarm` for short.
        after : str
            Of a descriptor: empty as shared, `strongest` after the attack that the
            verdict is about, or an attack's name, then with every adversary. Of
            linkage: `strongest` (or empty), or a linker's name.
        task : str
            Of linkage; by default the first of the run.
        robot : str
            Predictor whose utility it is; by default the first of the run.

        Mechanisms that add nothing (raw, clean) have level 0. Raises SettingsError for
        a metric, attack, task or robot that the run does not have.
        """
        name = _metric_name(metric)
        rows = self.measured
        rows = rows[rows["metric"] == name]
        row_tasks = rows["consumer"].map(lambda consumer: parse_consumer(consumer).task)
        task = task or next(iter(row_tasks), "")
        rows = rows[row_tasks == task]
        stage = METRICS[name].kind
        if stage == "predictor":
            consumer = robot or next(iter(rows["consumer"]), "")
        elif stage == "descriptor" and not after:
            consumer = SHARED
        else:
            attack = parse_consumer(after)
            if after in ("", STRONGEST):
                attack = self.strongest.get(task, Address())
                rows = rows[rows["knowledge"] == attack.adversary]
            consumer = replace(attack, task=task).consumer
        values = _consumer_rows(rows, consumer, metric=name, asked=after)
        table = self._level_frame(values)
        table.attrs["title"] = (
            f"{METRICS[name].title}, {_positions_label(values, stage)}"
        )
        return table

    def _level_frame(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Return rows of a summary with the columns that `frame` promises."""
        known = rows["mechanism"].map(self.families)
        is_attack = rows["knowledge"] != ""
        attack = [
            parse_consumer(consumer).attack_spec if is_so else ""
            for consumer, is_so in zip(rows["consumer"], is_attack, strict=True)
        ]
        columns = {
            "family": [family.name for family in known],
            "level": rows["level"].where(
                known.map(lambda family: family.is_added), 0.0
            ),
            "adding": [family.adding for family in known],
            "attack": attack,
        }
        columns |= {column: rows[column] for column in ("knowledge", *ENDS)}
        return pd.DataFrame(columns).reset_index(drop=True)

    def plot(
        self, *, x: str, y: str, task: str = "", robot: str = "", ax: Axes | None = None
    ) -> Axes:
        """Draw one metric over another, with 95 % intervals, and return the axes.

        `x` and `y` are metrics as in `frame`, or `plr_after`: after the strongest
        attack; `x` may be `level`, on a logarithmic axis, where raw is a line in its
        interval. A mechanism looks as on the page. `ax` are the axes to draw on, else
        new axes.
        """
        from evaluation.reporting.plots import (  # noqa: PLC0415 - matplotlib is slow to import, and seldom needed
            draw_metrics,
        )

        y_rows = self._scaled(y, task=task, robot=robot)
        over_level = x == "level"
        if over_level:
            x_rows = y_rows.assign(
                value=y_rows["level"], ci_low=math.nan, ci_high=math.nan
            )
            units = (f"{name} {unit}" for name, unit in LEVEL_UNITS.items())
            x_rows.attrs["title"] = "; ".join(["level", *units])
        else:
            x_rows = self._scaled(x, task=task, robot=robot)
        return draw_metrics(
            x_rows,
            y_rows,
            families=self.families.values(),
            over_level=over_level,
            ax=ax,
        )

    def _scaled(self, name: str, *, task: str = "", robot: str = "") -> pd.DataFrame:
        """Return a metric as it is shown, by a name that may end in `AFTER`."""
        metric = name.removesuffix(AFTER)
        after = STRONGEST if metric != name else ""
        rows = self.frame(metric, after=after, task=task, robot=robot)
        rows[ENDS] *= METRICS[SHORT.get(metric, metric)].scale
        return rows

    @property
    def dataset(self) -> str:
        """Name of the data set."""
        return str(self.manifest["dataset"]["name"])

    @property
    def n_reports(self) -> int:
        """Samples of a track's history, on average."""
        points: float = self.manifest["history"]["points"]
        return round(points)

    @cached_property
    def ours(self) -> pd.DataFrame:
        """The summary without the tasks that have a data set of their own."""
        rows = self.without_policy
        return rows[rows["dataset"] == self.dataset]

    @cached_property
    def families(self) -> dict[str, Family]:
        """The mechanisms of the run by name; the manifest knows which protect."""
        families = families_in(self.summary)
        for name, declared in entry_families(self.manifest.get("cells", ())).items():
            if name in families:
                families[name] = replace(families[name], protects=declared.protects)
        return families

    @cached_property
    def headline(self) -> Headline:
        """The numbers of the first table, for terminal, tables and page."""
        from evaluation.reporting.headline import headline  # noqa: PLC0415 - see `load`

        return headline(
            self.without_policy,
            attacks=self.strongest,
            linkability=self.linkability,
            attacked=self.attacked,
            epsilon_m=float(self.manifest["settings"]["stages"]["privacy.epsilon_m"]),
        )

    @cached_property
    def tasks(self) -> list[TaskOutcomes]:
        """The linkage tasks, on the run's data set or on their own."""
        from evaluation.estimates.linkability import task_outcomes  # noqa: PLC0415 - see `load`
        from evaluation.estimates.recordings import task_recording  # noqa: PLC0415 - see `load`

        expected = [
            task_recording(parse_consumer(consumer).task, dataset=self.dataset)
            for consumer in self.linkability["consumer"]
        ]
        return task_outcomes(self.linkability[self.linkability["dataset"] == expected])


def _metric_name(metric: str) -> str:
    """Return a metric's name in `summary.csv`. Raises SettingsError if unknown."""
    name = SHORT.get(metric, metric)
    if name not in METRICS:
        listed = f"; known: {', '.join(METRICS)}"
        hint = did_you_mean(metric, [*METRICS, *SHORT], quote="'") or listed
        raise SettingsError(f"unknown metric {metric!r}{hint}")
    return name


def _consumer_rows(
    rows: pd.DataFrame, consumer: str, *, metric: str, asked: str
) -> pd.DataFrame:
    """Return the rows of a consumer among those of a metric and a task.

    Raises SettingsError without any, about `asked` if the run has no such consumer.
    """
    own = rows[rows["consumer"] == consumer]
    if own.empty:
        has = ", ".join(dict.fromkeys(rows["consumer"])) or "nobody in this task"
        raise SettingsError(
            f"the run has no {metric} of {consumer or asked!r}; it has that of {has}"
        )
    return own


def _positions_label(rows: pd.DataFrame, stage: str) -> str:
    """Return which positions the rows of a consumer are about.

    `stage` is the stage that measures their metric.
    """
    consumer, knowledge = str(rows["consumer"].iloc[0]), rows["knowledge"].unique()
    if consumer == SHARED:
        return "as shared"
    label = parse_consumer(consumer, knowledge[0] if len(knowledge) == 1 else "").label
    if stage in ("descriptor", "reconstruction", "distance"):
        return f"after {label}"
    return label


def mechanism_columns(known: Mapping[str, Family]) -> list[Column]:
    """Return the columns mechanism, adding rule and level of a table."""

    def family(record: Mapping[str, Any]) -> Family:
        return find_family(known, record["mechanism"])

    return [
        text_column("mechanism", lambda record: family(record).name),
        text_column("adding", lambda record: family(record).adding),
        Column("level", lambda record: level_cell(record["level"])),
    ]


def estimates_by_level(
    frame: pd.DataFrame,
) -> dict[MechanismLevel, dict[Address, dict[str, Estimate]]]:
    """Return the estimates of a summary by level, rising, then reader, then metric."""
    by_level: dict[MechanismLevel, dict[Address, dict[str, Estimate]]] = {}
    ordered = frame.sort_values("level", kind="stable", na_position="first")
    for key, estimate in estimates(ordered).items():
        by_reader = by_level.setdefault(key.mechanism_level, {})
        by_reader.setdefault(key.reader, {})[key.metric] = estimate
    place = {name: n for n, name in enumerate(frame["mechanism"].unique())}
    return dict(sorted(by_level.items(), key=lambda item: place[item[0][0]]))


def reader_rows(frame: pd.DataFrame, reader: Address) -> pd.DataFrame:
    """Return the rows of a summary about the positions of a reader."""
    is_same = frame["knowledge"].fillna("") == reader.adversary
    return frame[is_same & (frame["consumer"] == reader.consumer)]


def representative_levels(
    mechanism_levels: Iterable[MechanismLevel],
    known: Mapping[str, Family],
    *,
    controls: bool = True,
) -> list[MechanismLevel]:
    """Return the few levels that represent a run; all of them if it has none of these.

    Those are mechanisms without levels, the headline levels of FID and fixed noise,
    both ends of every other mechanism, and all levels of the controls if these are
    wanted.
    """
    levels: dict[str, list[float | None]] = {}
    for mechanism, level in mechanism_levels:
        levels.setdefault(mechanism, []).append(level)
    families = {mechanism: find_family(known, mechanism) for mechanism in levels}
    headline_names = {name for name, _ in MAIN_LEVELS}
    chosen: dict[str, list[float | None]] = {}
    for mechanism, own in levels.items():
        family = families[mechanism]
        if family.name in headline_names:
            chosen[mechanism] = [x for x in own if (family.name, x) in MAIN_LEVELS]
        elif family.family in CONTROL_FAMILIES:
            chosen[mechanism] = [x for x in own if controls or x is None]
        else:
            chosen[mechanism] = list(dict.fromkeys([own[0], own[-1]]))
    has_headline_level = any(
        set(chosen[name]) - {None}
        for name in chosen
        if families[name].name in headline_names
    )
    if not has_headline_level:
        chosen = levels
    # First mechanisms that add nothing; last those that declare no rule.
    rules = [*ADDING_RULES, ""]

    def rank(name: str) -> int:
        family = families[name]
        return 1 + rules.index(family.adding) if family.is_added else 0

    return [
        MechanismLevel(name, level)
        for name in sorted(chosen, key=rank)
        for level in chosen[name]
    ]
