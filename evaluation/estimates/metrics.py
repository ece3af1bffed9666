"""THE table of metrics, which everything that lists metrics or descriptors reads.

A new metric is a row here, and the function that computes it.
"""

from dataclasses import dataclass
from typing import Final, Literal

MetricKind = Literal[
    "predictor",
    "descriptor",
    "reconstruction",
    "distance",
    "linkage",
    "bound",
    "patrol",
    "returns",
    "tracking",
]
"""Kinds of metric, in this order: a predictor's utility; a privacy descriptor of
positions, as shared and after a reconstruction; a further measure of a reconstruction;
the distance of positions beyond epsilon; a linker's success; a bound on all attacks in
a world of the fitted motion; what a disclosure policy costs and reveals on patrols;
the evidence on people who come back; how well a tracker associates detections."""


@dataclass(frozen=True, slots=True)
class Metric:
    """A number of a run: its meaning, and its form on screen and page."""

    name: str  # As in `summary.csv`.
    head: str  # Over a column: the field's own name, short.
    kind: MetricKind
    summary_unit: str = "fraction"  # Unit of its values in `summary.csv`.
    noun: str = ""  # In a sentence; empty: as over a column.
    digits: int = 1  # Shown after the point, in the unit shown.
    # Column of a cell's tracks: the metric is its mean over the tracks with a value.
    column: str = ""
    # Column whose sum divides the sum of `column`, instead of the number of tracks.
    over: str = ""
    is_root: bool = False  # Whether the metric is the square root of that ratio.
    # Whether it is among the few metrics tested first where runs are compared.
    is_headline: bool = False
    # Whether its replicates are biased, so that its intervals are basic intervals.
    is_biased: bool = False
    is_difference: bool = False  # Whether it is a difference, which may be negative.

    @property
    def is_share(self) -> bool:
        """Whether it is a share of trials, 0..1."""
        return self.summary_unit == "fraction" and not self.is_difference

    @property
    def unit(self) -> str:
        """Unit shown; empty for a ratio."""
        return {"fraction": "%", "ratio": ""}.get(self.summary_unit, self.summary_unit)

    @property
    def scale(self) -> float:
        """Factor from a value to the number shown."""
        return 100.0 if self.summary_unit == "fraction" else 1.0

    @property
    def title(self) -> str:
        """Heading with the unit in brackets."""
        return f"{self.head} ({self.unit})" if self.unit else self.head

    @property
    def text(self) -> str:
        """Name in a sentence."""
        return self.noun or self.head


_ROWS: Final = (
    Metric(
        "missed_conflict_rate",
        "missed",
        "predictor",
        noun="missed-conflict rate",
        is_headline=True,
    ),
    Metric(
        "missed_future_rate", "missed future", "predictor", noun="missed-future rate"
    ),
    Metric(
        "false_alarm_rate",
        "false alarm",
        "predictor",
        noun="false-alarm rate",
        is_headline=True,
    ),
    Metric("distance_mae", "distance MAE", "predictor", "m", digits=2),
    Metric("plr_robot", "robot's own PLR", "predictor"),
    Metric("plr", "PLR", "descriptor", column="plr", is_headline=True),
    Metric("ael", "AEL", "descriptor", "s", digits=3, column="ael_s", is_headline=True),
    Metric("mel", "MEL", "descriptor", "s", digits=3, column="mel_s", is_headline=True),
    Metric("plr_worst_tenth", "PLR, worst tenth", "reconstruction"),
    Metric(
        "rmse", "RMSE", "reconstruction", "m", digits=3, column="mse_m2", is_root=True
    ),
    Metric(
        "rmse_over_benchmark",
        "RMSE ratio",
        "reconstruction",
        "ratio",
        digits=2,
        column="mse_m2",
        over="benchmark_mse_m2",
        is_root=True,
    ),
    Metric(
        "plr_over_benchmark",
        "PLR ratio",
        "reconstruction",
        "ratio",
        digits=2,
        column="plr",
        over="benchmark_plr",
    ),
    Metric("plr_wide", "PLR at 4/3 epsilon", "distance", column="plr_wide"),
    Metric(
        "median_error",
        "median error",
        "distance",
        "m",
        digits=2,
        column="median_error_m",
    ),
    Metric(
        "plr_gap", "below the optimum", "bound", column="plr_gap", is_difference=True
    ),
    Metric("rank1_optimum", "optimal rank 1", "bound"),
    Metric("rank1_gap", "below the optimum", "bound", is_difference=True),
    Metric("plr_optimum", "optimal PLR", "bound", column="plr_optimum"),
    Metric("plr_ceiling", "PLR ceiling", "bound", column="plr_ceiling"),
    Metric("rank1", "rank 1", "linkage", is_headline=True),
    Metric("rank1_g100", "rank 1 of 100", "linkage", is_headline=True),
    Metric("rank1_assigned", "rank 1, assigned", "linkage"),
    Metric("false_link_rate", "false links", "linkage"),
    Metric("mrr", "MRR", "linkage", "ratio", digits=3),
    Metric("auc", "AUC", "linkage"),
    Metric("eer", "EER", "linkage", is_biased=True),
    Metric("tpr_at_fpr_1pct", "TPR at FPR 1 %", "linkage"),
    Metric("tpr_at_fpr_01pct", "TPR at FPR 0.1 %", "linkage"),
    Metric("cllr", "Cllr", "linkage", "bit", digits=3),
    Metric("cllr_min", "Cllr_min", "linkage", "bit", digits=3, is_biased=True),
    Metric("d_sys", "D_sys", "linkage", "ratio", digits=3),
    Metric("d_sys_published", "D_sys, published program", "linkage", "ratio", digits=3),
    Metric("d_sys_corrected", "D_sys, corrected", "linkage", "ratio", digits=3),
    Metric("residual_risk", "residual risk", "linkage"),
    Metric("chance", "chance", "linkage"),
    Metric(
        "missed_future_at_equal_false_alarms",
        "at equal false alarms",
        "patrol",
        noun="future conflicts missed at equal false alarms",
    ),
    Metric("missed_encounter_rate", "missed encounters", "patrol"),
    Metric("withheld_share", "withheld", "patrol"),
    Metric(
        "false_alarms_per_min", "false alarms a minute", "patrol", "1/min", digits=2
    ),
    Metric("disclosed_share", "disclosed", "patrol"),
    Metric("known_share", "known", "patrol", noun="known share of person-time"),
    Metric("known_worst_tenth", "known, worst tenth", "patrol"),
    Metric("known_undisclosed", "known, not sent", "patrol"),
    Metric("people_seen", "people seen", "patrol"),
    Metric("plr_walk", "PLR of walks", "patrol"),
    Metric("followed_s", "followed", "patrol", "s"),
    Metric("followed_10s", "followed 10 s", "patrol"),
    Metric("followed_30s", "followed 30 s", "patrol"),
    Metric("time_to_confusion_s", "time to confusion", "patrol", "s"),
    Metric("rank1_gain", "gain over the control", "returns", is_difference=True),
    Metric("nested_p", "nested p", "returns", "ratio", digits=3),
    Metric(
        "confirming_gain",
        "gain in the session left aside",
        "returns",
        is_difference=True,
    ),
    Metric("confirming_p", "nested p there", "returns", "ratio", digits=3),
    Metric("gospa", "GOSPA", "tracking", "m", digits=2),
    Metric("ospa", "OSPA", "tracking", "m", digits=2),
    Metric("hota", "HOTA", "tracking", "ratio", digits=2),
    Metric("purity", "purity", "tracking"),
    Metric("id_switches", "switches", "tracking", "1/min", digits=1),
    Metric("fragments", "fragments", "tracking", "1/min", digits=2),
    Metric("rejoined_share", "rejoined", "tracking"),
    Metric("linkable_share", "linkable", "tracking"),
)
# In the order in which they are shown.
METRICS: Final = {metric.name: metric for metric in _ROWS}


def metric_names(*kinds: MetricKind) -> tuple[str, ...]:
    """Return the names of the metrics of some kinds, in the order shown."""
    return tuple(metric.name for metric in _ROWS if metric.kind in kinds)


UTILITY: Final = metric_names("predictor")
# Privacy descriptors: PLR, AEL and MEL.
DESCRIPTORS: Final = metric_names("descriptor")
# Metrics of the positions that an attack rebuilds.
RECONSTRUCTION: Final = metric_names("descriptor", "reconstruction")
DISTANCE: Final = metric_names("distance")  # Whether errors lie just outside epsilon.
PLR_WIDE, MEDIAN_ERROR = DISTANCE
PLR_GAP: Final = "plr_gap"  # In model worlds alone.
RANK1_OPTIMUM, RANK1_GAP = "rank1_optimum", "rank1_gap"  # Optimum and gap of rank 1.
PLR_CEILING: Final = "plr_ceiling"
# Bounds of PLR after any attack, the exact bound first.
BOUNDS: Final = ("plr_optimum", PLR_CEILING)
MISSED_RATE: Final = "missed_conflict_rate"  # Cost of noise to a robot.
MISSED_FUTURE: Final = "missed_future_rate"
"""Missed rate of conflicts to come: nobody is inside the safety radius at step 0."""
EQUAL_ALARMS: Final = "missed_at_equal_false_alarms"
"""Missed conflicts at the predictor's false alarms under raw; not in the summary."""
FUTURE_EQUAL_ALARMS: Final = "missed_future_at_equal_false_alarms"
"""Missed conflicts that are still to come, at that same rate; in the summary only of
patrols."""
WITHHELD: Final = "withheld_share"  # Conflicts that a policy hides from a robot.
KNOWN_SHARE: Final = "known_share"  # Person-time that an adversary with a log knows.
DISCLOSED: Final = "disclosed_share"  # Person-time of which a position was sent.
FOLLOWED: Final = "followed_10s"  # People followed for ten seconds by a log.
# Costs of noise.
COSTS: Final = (
    MISSED_RATE,
    MISSED_FUTURE,
    EQUAL_ALARMS,
    FUTURE_EQUAL_ALARMS,
)
FALSE_ALARMS: Final = "false_alarm_rate"
DISTANCE_MAE: Final = "distance_mae"  # Error of the separation that a robot predicts.
ROBOT_PLR: Final = "plr_robot"  # PLR of the positions that a robot itself estimates.
ROBOTS_OWN: Final = (DISTANCE_MAE, ROBOT_PLR)  # Robots' own metrics in `frontier.csv`.
CHANCE: Final = "chance"  # Rank 1 by guessing.
WORST_TENTH: Final = "plr_worst_tenth"  # PLR of the most exposed tenth of the people.
PLR: Final = "plr"  # The descriptor by which reconstructions are ranked.
RANK1: Final = "rank1"  # The metric by which linkers are ranked.
RANK1_JOINT: Final = "rank1_assigned"  # Rank 1 where all probes are matched at once.
# Rank 1 in a gallery of 100, which compares over runs.
RANK1_AMONG_100: Final = "rank1_g100"
LINKAGE_SHARE: Final = "linkage_share"
"""Rank 1 less chance, as a share of the same under raw, paired; `levels.csv` only."""
LINKAGE_COMPARED: Final = (RANK1, "auc")  # Linkers' metrics compared at equal cost.
