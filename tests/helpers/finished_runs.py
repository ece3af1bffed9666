"""Frames of a finished run, made up: what tables, figures and page are shown from."""

import copy
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from helpers.addresses import entry_at

from evaluation.estimates import (
    by_speed,
    decisions,
    frontier,
    linkability,
    matching,
    paper,
    recordings,
    strongest_table,
    summary,
)
from evaluation.estimates import levels as levels_table
from evaluation.estimates import weak_attacks as flags
from evaluation.estimates.best_robot import BEST
from evaluation.estimates.metrics import (
    DESCRIPTORS,
    FUTURE_EQUAL_ALARMS,
    METRICS,
    MISSED_FUTURE,
    ROBOT_PLR,
    UTILITY,
)
from evaluation.estimates.strongest_table import SINGLE_RELEASE
from evaluation.plan.address import parse_consumer
from evaluation.reporting.rows import Results
from evaluation.store.entries import FAILED_COLUMNS
from evaluation.store.files import FRAMES
from isac_track.config import StageSettings

MADE = json.loads(
    Path(__file__).with_name("finished_run.json").read_text(encoding="utf-8")
)
MANIFEST, VERDICT = MADE["manifest"], MADE["verdict"]
MANIFEST["settings"]["stages"] = StageSettings().flat() | {"patrol.segment_s": 300.0}
MANIFEST["history"] = {"points": 366.4, "interval_s": 0.0836}
ITEM = VERDICT["items"][0]
INDEPENDENT = ":adding=independent"
BOTH_RULES = ("", INDEPENDENT)
SWEPT = (("fid", (1.0, 1000.0)), ("fixed", (0.4, 0.7, 1.0)))
NO_RULE = ("raw", "clean", "offset", "thin", "ou")
"""Mechanisms that declare no adding rule; `ou` is a stranger's."""
CONTROLS = [("offset", 0.4), ("correlated", 0.5), (f"correlated{INDEPENDENT}", 0.5)]
CONTROLS += [("thin:d_sigma=0.75", 4.0)]
COSTS = tuple(
    name for name in UTILITY if name != ROBOT_PLR
)  # made-up robots have no `track`
UNITS = {name: METRICS[name].summary_unit for name in (*COSTS, *DESCRIPTORS, "rmse")}
REBUILT = (*DESCRIPTORS, "rmse")
RATIOS = dict.fromkeys(("rmse_over_benchmark", "plr_over_benchmark"), "ratio")
ATTACKS = (
    ("identity", "blind"),
    *(
        (name, knows)
        for name in ("moving_average", "savgol")
        for knows in ("blind", "informed")
    ),
    *(("kalman_rts", knows) for knows in ("blind", "informed", "oracle")),
    *(("radial_rts", knows) for knows in ("blind", "informed")),
    ("averaging", "oracle"),
)
LINKERS = {"rerelease": {"shape": 0.4, "shape@radial_rts": 0.6}}
COHORTS = {"without_groups": 0.0206, "without_frozen": 0.0073}
"""Chance without a confounder."""
CHANCE = 0.0072
STRONGEST = {
    "": parse_consumer("radial_rts", "informed"),
    "rerelease": parse_consumer("shape@radial_rts", "informed"),
}


def levels(*, swept=SWEPT, rules=BOTH_RULES, others=CONTROLS):
    """No error, what is swept under each rule, and others."""
    return [
        ("clean", np.nan),
        ("raw", np.nan),
        *((f"{name}{rule}", at) for rule in rules for name, ats in swept for at in ats),
        *others,
    ]


def described(mechanism):
    """Family and adding rule of a mechanism."""
    family = mechanism.partition(":")[0]
    rule = "independent" if INDEPENDENT[1:] in mechanism else "linear"
    bare = mechanism in NO_RULE
    return {"family": family, "adding": "" if bare or family in NO_RULE[:3] else rule}


def metric_value(place, metric):
    """The value of a metric at a level's place: misses rise, all others fall."""
    if metric in ("missed_conflict_rate", "false_alarm_rate"):
        return 0.1 + 0.02 * place
    if metric == MISSED_FUTURE:
        return 0.15 + 0.025 * place
    falling = [name for name in UNITS if name != MISSED_FUTURE]
    return 0.9 / (1.37 + place + falling.index(metric))


def make_summary(
    at=None, *, dataset="students03", predictors=("least_squares",), attacks=ATTACKS
):
    """As `summary.csv`: shared, predictors, and attacks that lift what was shared."""
    rows = []
    for place, (mechanism, level) in enumerate(levels() if at is None else at):
        where = {"dataset": dataset, "mechanism": mechanism, "level": level, "n": 55}
        where |= described(mechanism)
        cells = [("shared", "", metric, 1.0) for metric in REBUILT]
        cells += [(name, "", metric, 1.0) for name in predictors for metric in COSTS]
        for n, (name, knowledge) in enumerate(attacks):
            lift = 1.0 if name == "identity" else 1.0 + 0.02 * n
            cells += [(name, knowledge, metric, lift) for metric in REBUILT]
            cells += [(name, knowledge, metric, 0.0) for metric in RATIOS]
        for consumer, knowledge, metric, lift in cells:
            value = lift * metric_value(place, metric) if lift else 1.0
            ends = {"value": value, "ci_low": 0.9 * value, "ci_high": 1.1 * value}
            ends |= {"consumer": consumer, "knowledge": knowledge, "metric": metric}
            rows.append(where | ends | {"unit": (UNITS | RATIOS)[metric]})
    return pd.DataFrame(rows, columns=summary.COLUMNS)


def make_linkability(at=None, *, tasks=LINKERS, dataset="students03", cohorts=COHORTS):
    """As `linkability.csv`: three adversaries of each linker, controls, and cohorts."""
    rows = []
    for task, strengths in tasks.items():
        for place, (mechanism, level) in enumerate(levels() if at is None else at):
            where = {
                "dataset": recordings.task_recording(task, dataset=dataset),
                "mechanism": mechanism, "level": level, "invalid": "", "outcome": "links",
                "chance": CHANCE, "cohort": "all", "n_probes": 276, "n_mated": 276,
                "n_clusters": 175, "gallery_min": 138, "gallery_mean": 138.0, "gallery_max": 138,
            }  # fmt: skip
            for name in ("random", "duration", "noise_level"):
                control = {
                    "consumer": f"{task}/control-{name}",
                    "knowledge": "",
                    "p_value": 0.4,
                }
                rows.append(where | control | {"outcome": "at chance", "rank1": CHANCE})
            for linker, strength in strengths.items():
                for knowledge, share in (
                    ("blind", 0.8),
                    ("informed", 1.0),
                    ("oracle", 1.1),
                ):
                    rank1 = share * strength / (1.0 + 0.1 * place)
                    row = {
                        "consumer": f"{task}/{linker}",
                        "knowledge": knowledge,
                        "rank1": rank1,
                    }
                    row |= {
                        "ci_low": 0.9 * rank1,
                        "ci_high": 1.1 * rank1,
                        "p_value": 0.001,
                    }
                    rows.append(where | row)
                    for cohort, chance in cohorts.items():
                        rows.append(where | row | {"cohort": cohort, "chance": chance})
    return pd.DataFrame(rows, columns=linkability.COLUMNS)


def make_matched(*, dataset="students03"):
    """As `matched.csv`, at three rates each."""
    rows = [
        {
            "dataset": dataset, "criterion": "missed", "adding": adding, "at": rate,
            "predictor": "least_squares", "consumer": "shared", "knowledge": "", "metric": metric,
            "missed_conflict_rate": 0.1 + rate, "fid": 0.2, "fid_low": 0.1, "fid_high": 0.3,
            "fixed": 0.4, "fixed_low": 0.3, "fixed_high": 0.5, "difference": -rate,
            "ci_low": -rate - 0.01, "ci_high": -rate + 0.01, "defined": 1.0, "n": 50,
            "mechanism": f"fid{INDEPENDENT * (adding == 'independent')}", "family": "fid",
        }
        for adding in ("linear", "independent")
        for metric in ("plr", "ael", "mel")
        for rate in (0.12, 0.02, 0.08)
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=matching.COLUMNS)


def make_frontier(*, dataset="students03"):
    """As `frontier.csv`: of one robot; the dearest target is out of reach."""
    rows = [
        {
            "dataset": dataset, "mechanism": mechanism, "family": mechanism, "adding": "linear",
            "robot": "least_squares", "criterion": "missed", "target": target, "n": 50,
            "consumer": consumer, "knowledge": knows, "metric": metric,
        }
        | ({} if target == 0.1 else {
            "level": 10.0 * target, "level_low": 9.0 * target, "level_high": 11.0 * target,
            "value": left, "ci_low": 0.9 * left, "ci_high": 1.1 * left, "dominated": place > 0,
        })
        for place, mechanism in enumerate(("fid", "fixed"))
        for target in frontier.TARGETS
        for consumer, knows, metric in (
            ("shared", "", "plr"),
            ("radial_rts", "informed", "plr"),
            ("rerelease/shape@radial_rts", "informed", "rank1"),
        )
        for left in [0.8 + 0.1 * place - target]
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=frontier.COLUMNS)


def make_speeds(*, dataset="students03"):
    """As `by_speed.csv`: who stands is known better, at two levels of either rule."""
    rows = [
        {
            "dataset": dataset, "mechanism": mechanism, "level": level, "consumer": consumer,
            "knowledge": knows, "speed_low_mps": 0.5 * n, "speed_high_mps": 0.5 * n + 0.5,
            "speed_mps": 0.5 * n + 0.2, "value": lift / (1.0 + n), "ci_low": 0.9 * lift / (1.0 + n),
            "ci_high": 1.1 * lift / (1.0 + n), "n": 20,
        }
        for mechanism, level in (("raw", np.nan), ("fid", 1.0), (f"fid{INDEPENDENT}", 1.0))
        for consumer, knows, lift in (("shared", "", 0.3), ("radial_rts", "informed", 0.6))
        for n in range(3)
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=by_speed.COLUMNS)


def make_curves(at=None, *, dataset="students03"):
    """As `curves.csv`: two scores of one predictor."""
    rows = [
        [dataset, mechanism, level, "least_squares", score, x, 1.0 - x]
        for mechanism, level in (levels() if at is None else at)
        for score in ("separation", "probability")
        for x in (0.0, 0.5, 1.0)
    ]
    rates = "false_alarm_rate", "missed_conflict_rate"
    return pd.DataFrame(rows, columns=[*decisions.DECISION_COLUMNS[:5], *rates])


def make_gallery():
    """As `gallery.parquet`: four straight walks, every other shared sample leaks."""
    t = np.arange(8.0)
    return pd.concat(
        pd.DataFrame(
            {
                "track": track, "source": f"p{track}", "mechanism": mechanism,
                "attack": "radial_rts", "epsilon_m": 0.3, "t": t, "x_true": t, "y_true": track,
                "x_shared": t + 0.1, "y_shared": track + 0.2, "x_rec": t, "y_rec": track + 0.1,
                "leaked_shared": t % 2 == 0, "leaked_rec": t > 1,
            }
        )
        for track in range(4)
        for mechanism in ("raw", "fid:1", "fixed:0.8")
    )  # fmt: skip


def make_flags(**changes):
    """As the rows of `flags.json`: one attack that is beaten."""
    row = {
        "kind": "beaten", "mechanism": "raw", "level": np.nan, "attack": "radial_rts",
        "knowledge": "informed", "by": "radial_rts", "by_knowledge": "blind", "metric": "plr",
        "difference": 0.003, "ci_low": 0.001, "ci_high": 0.005, "compared": 47, "sentence": "",
    }  # fmt: skip
    return pd.DataFrame([row | changes], columns=flags.COLUMNS)


def make_levels(summary, linkability, *, dataset="students03"):
    """As `levels.csv` of a summary: its numbers, with names of that table."""
    rows = summary[(summary["dataset"] == dataset) & (summary["family"] != "clean")]
    missed = rows[rows["metric"] == "missed_conflict_rate"]
    ahead = missed.assign(
        metric="missed_future_at_equal_false_alarms", dataset=f"{dataset}:horizon=3s"
    )
    robot = ahead.groupby("consumer")["value"].mean().idxmin() if len(ahead) else ""
    best_robot = ahead[ahead["consumer"] == robot].assign(
        consumer=BEST[FUTURE_EQUAL_ALARMS], first_choice=robot, second_choice=robot
    )
    shared = rows[(rows["consumer"] == "shared") & rows["metric"].isin(DESCRIPTORS)]
    attacked = rows[rows["knowledge"].isin(["informed", "repeats", "anchor"])]
    best = {
        itertuple.knowledge: itertuple.consumer for itertuple in attacked.itertuples()
    }
    attacked = attacked[attacked["consumer"] == attacked["knowledge"].map(best)]
    attacked = attacked[attacked["metric"].isin(DESCRIPTORS)]
    beyond = attacked["knowledge"] != "informed"
    attacked = attacked.assign(
        adversary=attacked["knowledge"].where(beyond, SINGLE_RELEASE)
    )
    plr = attacked[attacked["metric"] == "plr"]
    linked = linkability[
        (linkability["cohort"] == "all") & (linkability["knowledge"] != "")
    ]
    linked = linked[linked["knowledge"] == "informed"]
    linked = linked.assign(
        metric="rank1", value=linked["rank1"], adversary=SINGLE_RELEASE, n=55
    )
    linked = linked.merge(rows[["mechanism", "family", "adding"]].drop_duplicates())
    parts = [
        missed,
        ahead,
        best_robot,
        shared,
        attacked,
        plr.assign(metric="plr_wide"),
        linked,
    ]
    whole = pd.concat([part for part in parts if len(part)] or [missed])
    protects = ~whole["family"].isin(["raw", "offset", "correlated", "thin"])
    return whole.assign(protects=protects).reindex(columns=levels_table.COLUMNS)


def make_run(out=Path(), dataset="students03", *, at=None, **changes):
    """A finished run at some levels; any of its frames may be another."""
    manifest = copy.deepcopy(MANIFEST)
    manifest["dataset"]["name"] = dataset
    parts = {
        "manifest": manifest,
        "summary": make_summary(at, dataset=dataset),
        "paper_table": pd.DataFrame(MADE["paper_table"], columns=paper.PAPER_COLUMNS),
        "claims": pd.DataFrame(MADE["claims"], columns=paper.CLAIM_COLUMNS),
        "matched": make_matched(dataset=dataset),
        "frontier": make_frontier(dataset=dataset),
        "decisions": pd.DataFrame(columns=decisions.DECISION_COLUMNS, dtype=float),
        "curves": make_curves(at, dataset=dataset),
        "flags": make_flags().head(0),
        "linkability": make_linkability(at, dataset=dataset),
        "verdict": VERDICT,
        "failed": pd.DataFrame(columns=list(FAILED_COLUMNS)),
        "galleries": pd.DataFrame(),
        "speeds": make_speeds(dataset=dataset),
        "attacked": pd.DataFrame(columns=strongest_table.COLUMNS),
        "strongest": STRONGEST,
    }
    parts |= changes
    made = make_levels(parts["summary"], parts["linkability"], dataset=dataset)
    return Results(out=out, **({"levels": made} | parts))


def with_links(run):
    """A run whose summary holds what its linkers achieve."""
    result = run.linkability[
        (run.linkability["cohort"] == "all") & (run.linkability["knowledge"] != "")
    ]
    result = result.assign(n=55, unit="fraction", family="", adding="")
    chance = result.assign(metric="chance", value=result["chance"])
    rows = [run.summary, result.assign(metric="rank1", value=result["rank1"]), chance]
    joined = pd.concat(rows)[run.summary.columns]
    about = run.summary.drop_duplicates("mechanism").set_index("mechanism")[
        ["family", "adding"]
    ]
    known = joined.drop(columns=["family", "adding"]).join(about, on="mechanism")
    return replace(run, summary=known[run.summary.columns])


def rows_where(frame, **values):
    """Which rows of a frame hold these values."""
    result = pd.Series(True, index=frame.index)
    for name, value in values.items():
        result &= frame[name] == value
    return result


def emptied(run):
    """All frames of a run without rows."""
    return {name: getattr(run, name).head(0) for name in (*FRAMES, "flags")}


def everything():
    """A run with all that a table may show: marks, leaks, strangers, flags."""
    at = levels(
        swept=(("fid", (1.0, 1000.0)), ("fixed", (0.7,))), others=[("offset", 0.4)]
    )
    at += [("ou", level) for level in (0.2, 0.4, 0.8)]
    some = [*(ATTACKS[n] for n in (0, 1, 2)), *ATTACKS[-2:]]
    linked = make_linkability(
        at, tasks=LINKERS | {"handover-2s": {"kinematic": 0.8, "dtw@averaging": 0.1}}
    )

    def change(values, **where):
        linked.loc[rows_where(linked, **where), list(values)] = list(values.values())

    sizes = {
        "gallery_min": 21,
        "gallery_mean": 37.66,
        "gallery_max": 52,
        "n_mated": 201,
    }
    linked.loc[linked["consumer"].str.startswith("handover"), list(sizes)] = list(
        sizes.values()
    )
    # A less knowing adversary is not shown, nor is what it fails at; who knows all is
    # named.
    change(
        {"outcome": "no link detected"},
        consumer="handover-2s/kinematic",
        knowledge="blind",
    )
    only = (linked["consumer"] == "handover-2s/dtw@averaging") & (
        linked["knowledge"] != "oracle"
    )
    linked = linked[~only]
    shape = {"consumer": "rerelease/shape", "knowledge": "informed"}
    change({"outcome": "no link detected"}, mechanism="fid", level=1.0, **shape)
    change({"outcome": "attack too weak"}, mechanism="raw", **shape)
    change({"invalid": "duration"}, mechanism="clean")
    best = shape | {
        "consumer": "rerelease/shape@radial_rts",
        "mechanism": "fid",
        "level": 1.0,
    }
    for cohort, rank1 in (
        ("all", 0.5),
        ("without_groups", 0.6),
        ("without_frozen", 0.49),
    ):
        change({"rank1": rank1}, cohort=cohort, **best)
    # Of a control that sees times alone one level counts.
    for name, p_value in (("duration", 0.03), ("noise_level", 0.05)):
        change({"p_value": p_value}, consumer=f"rerelease/control-{name}")
    change({"p_value": 0.01}, consumer="rerelease/control-random", level=0.7)
    matched = make_matched()
    others = [
        matched[matched["metric"] == "plr"].assign(
            consumer=name, knowledge=knows, metric="rank1"
        )
        for name in ("rerelease/shape", "rerelease/shape@radial_rts")
        for knows in ("blind", "informed")
    ]
    claim = ITEM | {"section": "claim", "of": "as-shared", "criterion": "missed"}
    alarms = {"criterion": "missed_at_equal_false_alarms", "decision": "holds"}
    items = [*VERDICT["items"], claim | {"decision": "reversed"}, claim | alarms]
    run = make_run(
        at=at,
        summary=make_summary(
            at, predictors=("least_squares", "kalman_cv"), attacks=some
        ),
        linkability=linked,
        flags=make_flags(),
        matched=pd.concat([matched, *others]),
        verdict=VERDICT | {"items": items},
    )
    run.manifest["linkage"]["tasks"] = {
        "handover-2s": {"people": 275, "too_short": 0, "not_drawn": 0}
    }
    run.manifest["cells"] = [
        entry_at("radial_rts", is_slow=True),
        entry_at("shared"),
    ]
    return run
