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
    about: str  # The sentence of the glossary: what it is, with its unit.
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
        "Share of conflicts that a robot misses.",
        noun="missed-conflict rate",
        is_headline=True,
    ),
    Metric(
        "missed_future_rate",
        "missed future",
        "predictor",
        "Share of future conflicts that a robot misses.",
        noun="missed-future rate",
    ),
    Metric(
        "false_alarm_rate",
        "false alarm",
        "predictor",
        "A robot expects a conflict that does not happen.",
        noun="false-alarm rate",
        is_headline=True,
    ),
    Metric(
        "distance_mae",
        "distance MAE",
        "predictor",
        "Mean absolute error of the distance that a robot predicts, m.",
        summary_unit="m",
        digits=2,
    ),
    Metric(
        "plr_robot",
        "robot's own PLR",
        "predictor",
        "Share of positions that the robot's own filter knows within epsilon.",
    ),
    Metric(
        "plr",
        "PLR",
        "descriptor",
        "Privacy leakage ratio: share of positions closer to the truth than epsilon.",
        column="plr",
        is_headline=True,
    ),
    Metric(
        "ael",
        "AEL",
        "descriptor",
        (
            "Average exposure length: how long positions leak without a break on"
            " average, s."
        ),
        summary_unit="s",
        digits=3,
        column="ael_s",
        is_headline=True,
    ),
    Metric(
        "mel",
        "MEL",
        "descriptor",
        "Maximum exposure length: the longest unbroken leak of a track, averaged, s.",
        summary_unit="s",
        digits=3,
        column="mel_s",
        is_headline=True,
    ),
    Metric(
        "plr_worst_tenth",
        "PLR, worst tenth",
        "reconstruction",
        "PLR of the most exposed tenth of the people.",
    ),
    Metric(
        "rmse",
        "RMSE",
        "reconstruction",
        "Root mean squared distance to the true positions, m.",
        summary_unit="m",
        digits=3,
        column="mse_m2",
        is_root=True,
    ),
    Metric(
        "rmse_over_benchmark",
        "RMSE ratio",
        "reconstruction",
        "RMSE divided by that of a linear benchmark smoother.",
        summary_unit="ratio",
        digits=2,
        column="mse_m2",
        over="benchmark_mse_m2",
        is_root=True,
    ),
    Metric(
        "plr_over_benchmark",
        "PLR ratio",
        "reconstruction",
        "PLR divided by that of a linear benchmark smoother.",
        summary_unit="ratio",
        digits=2,
        column="plr",
        over="benchmark_plr",
    ),
    Metric(
        "plr_wide",
        "PLR at 4/3 epsilon",
        "distance",
        "PLR with a distance limit one third larger.",
        column="plr_wide",
    ),
    Metric(
        "median_error",
        "median error",
        "distance",
        "Median distance to the true positions, m.",
        summary_unit="m",
        digits=2,
        column="median_error_m",
    ),
    Metric(
        "plr_gap",
        "below the optimum",
        "bound",
        "How far the best attack stays below the optimum, in points.",
        column="plr_gap",
        is_difference=True,
    ),
    Metric(
        "rank1_optimum",
        "optimal rank 1",
        "bound",
        "Rank 1 of the optimum in a model world.",
    ),
    Metric(
        "rank1_gap",
        "below the optimum",
        "bound",
        "How far the best attack stays below the optimum, in points.",
        is_difference=True,
    ),
    Metric(
        "plr_optimum",
        "optimal PLR",
        "bound",
        "PLR of the optimum in a model world.",
        column="plr_optimum",
    ),
    Metric(
        "plr_ceiling",
        "PLR ceiling",
        "bound",
        "PLR of an attacker who also knows the scale of every error.",
        column="plr_ceiling",
    ),
    Metric(
        "rank1",
        "rank 1",
        "linkage",
        "Share of people whose own other track comes first among the candidates.",
        is_headline=True,
    ),
    Metric(
        "rank1_g100",
        "rank 1 of 100",
        "linkage",
        "Rank 1 among 100 candidates, comparable between runs.",
        is_headline=True,
    ),
    Metric(
        "rank1_assigned",
        "rank 1, assigned",
        "linkage",
        "Rank 1 if all probes are matched at once.",
    ),
    Metric(
        "false_link_rate",
        "false links",
        "linkage",
        "Share of probes without a partner for which a linker names somebody.",
    ),
    Metric(
        "mrr",
        "MRR",
        "linkage",
        "Mean reciprocal rank of the right candidate.",
        summary_unit="ratio",
        digits=3,
    ),
    Metric(
        "auc",
        "AUC",
        "linkage",
        "Chance that a pair of one person scores above a pair of two people.",
    ),
    Metric(
        "eer",
        "EER",
        "linkage",
        "Error rate at the threshold where both kinds of error are equal.",
        is_biased=True,
    ),
    Metric(
        "tpr_at_fpr_1pct",
        "TPR at FPR 1 %",
        "linkage",
        "Share of true pairs accepted while 1 % of false pairs are.",
    ),
    Metric(
        "tpr_at_fpr_01pct",
        "TPR at FPR 0.1 %",
        "linkage",
        "Share of true pairs accepted while 0.1 % of false pairs are.",
    ),
    Metric(
        "cllr",
        "Cllr",
        "linkage",
        "Cost of the scores as log likelihood ratios, bit; 0 is perfect.",
        summary_unit="bit",
        digits=3,
    ),
    Metric(
        "cllr_min",
        "Cllr_min",
        "linkage",
        "Cllr after the best calibration, bit; 1 means no information.",
        summary_unit="bit",
        digits=3,
        is_biased=True,
    ),
    Metric(
        "d_sys",
        "D_sys",
        "linkage",
        "Global linkability measure from 0 to 1 (Gomez-Barrero et al.).",
        summary_unit="ratio",
        digits=3,
    ),
    Metric(
        "d_sys_published",
        "D_sys, published program",
        "linkage",
        "D_sys as the published program computes it.",
        summary_unit="ratio",
        digits=3,
    ),
    Metric(
        "d_sys_corrected",
        "D_sys, corrected",
        "linkage",
        "D_sys minus its mean over shuffled pairs.",
        summary_unit="ratio",
        digits=3,
    ),
    Metric(
        "residual_risk",
        "residual risk",
        "linkage",
        "Rank 1 above chance, as a share of all that is possible above chance.",
    ),
    Metric(
        "chance",
        "chance",
        "linkage",
        "Rank 1 of a random guess: one divided by the number of candidates.",
    ),
    Metric(
        "missed_future_at_equal_false_alarms",
        "at equal false alarms",
        "patrol",
        (
            "Future conflicts missed at the false alarms that a robot has if all is"
            " sent raw."
        ),
        noun="future conflicts missed at equal false alarms",
    ),
    Metric(
        "missed_encounter_rate",
        "missed encounters",
        "patrol",
        "Share of first entries of which a robot was not warned.",
    ),
    Metric(
        "withheld_share",
        "withheld",
        "patrol",
        "Share of conflicts that a robot would foresee if all were sent, and does not.",
    ),
    Metric(
        "false_alarms_per_min",
        "false alarms a minute",
        "patrol",
        "Runs of alarms of a robot without a conflict, 1/min.",
        summary_unit="1/min",
        digits=2,
    ),
    Metric(
        "disclosed_share",
        "disclosed",
        "patrol",
        "Share of person-time of which the nearest sample was sent.",
    ),
    Metric(
        "known_share",
        "known",
        "patrol",
        "Share of person-time that an adversary with the log states within epsilon.",
        noun="known share of person-time",
    ),
    Metric(
        "known_worst_tenth",
        "known, worst tenth",
        "patrol",
        "The same of the tenth of people that is known best.",
    ),
    Metric(
        "known_undisclosed",
        "known, not sent",
        "patrol",
        "Share of person-time that is known without a sample of it.",
    ),
    Metric(
        "people_seen",
        "people seen",
        "patrol",
        "Share of people with at least one answer in the log.",
    ),
    Metric(
        "plr_walk",
        "PLR of walks",
        "patrol",
        "PLR of whole walks, where samples that are not sent are safe.",
    ),
    Metric(
        "followed_s",
        "followed",
        "patrol",
        "Time within one chain of answers that are all of one person, s.",
        summary_unit="s",
    ),
    Metric(
        "followed_10s",
        "followed 10 s",
        "patrol",
        "Share followed so long, of the people present so long.",
    ),
    Metric(
        "followed_30s",
        "followed 30 s",
        "patrol",
        "Share followed so long, of people present for 30 s.",
    ),
    Metric(
        "time_to_confusion_s",
        "time to confusion",
        "patrol",
        "Time until an adversary is unsure who goes on (Hoh et al.), s; at most 30.",
        summary_unit="s",
    ),
    Metric(
        "rank1_gain",
        "gain over the control",
        "returns",
        "Rank 1 of people who come back, less that of the strongest control.",
        is_difference=True,
    ),
    Metric(
        "nested_p",
        "nested p",
        "returns",
        (
            "Chance of so high scores of the same person, beyond all controls, if"
            " people were exchanged."
        ),
        summary_unit="ratio",
        digits=3,
    ),
    Metric(
        "confirming_gain",
        "gain in the session left aside",
        "returns",
        "The same gain in a session that confirms.",
        is_difference=True,
    ),
    Metric(
        "confirming_p",
        "nested p there",
        "returns",
        "The same probability in a session that confirms.",
        summary_unit="ratio",
        digits=3,
    ),
    Metric(
        "gospa",
        "GOSPA",
        "tracking",
        "Distance of tracks from people, with a cost of misses and of false tracks.",
        summary_unit="m",
        digits=2,
    ),
    Metric(
        "ospa",
        "OSPA",
        "tracking",
        "The same as a mean over the larger of both sets, at most 1 m.",
        summary_unit="m",
        digits=2,
    ),
    Metric(
        "hota",
        "HOTA",
        "tracking",
        "How well tracks detect people and hold them, 0 to 1 (Luiten et al.).",
        summary_unit="ratio",
        digits=2,
    ),
    Metric(
        "purity",
        "purity",
        "tracking",
        "Share of samples of tracks that are of the track's main person.",
    ),
    Metric(
        "id_switches",
        "switches",
        "tracking",
        "Changes of the track that holds a person, per minute of presence.",
        summary_unit="1/min",
        digits=1,
    ),
    Metric(
        "fragments",
        "fragments",
        "tracking",
        "Further tracks of a person who has a track, per minute of presence.",
        summary_unit="1/min",
        digits=2,
    ),
    Metric(
        "rejoined_share",
        "rejoined",
        "tracking",
        "Share of breaks of a track after which the right track is joined.",
    ),
    Metric(
        "linkable_share",
        "linkable",
        "tracking",
        "Share of people with a track of their own on both sides of a silence.",
    ),
)
# In the order in which they are shown.
METRICS: Final = {metric.name: metric for metric in _ROWS}


def metric_names(*kinds: MetricKind) -> tuple[str, ...]:
    """Return the names of the metrics of some kinds, in the order shown."""
    return tuple(metric.name for metric in _ROWS if metric.kind in kinds)


UTILITY: Final = metric_names("predictor")
DESCRIPTORS: Final = metric_names("descriptor")  # Privacy descriptors.
PAPER_DESCRIPTORS: Final = ("plr", "ael", "mel")  # Those of the paper.
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
