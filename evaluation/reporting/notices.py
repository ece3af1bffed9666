"""What a reader of a run must know about its data and its people, in plain sentences.

Nothing heavy is imported here: the command that plans a run reads it, too.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from evaluation.plan.address import parse_label
from evaluation.plan.constants import BLOCK_SCENES
from evaluation.reporting.amounts import PERCENT, counted, listed, whole_percent

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from evaluation.plan.plan import Plan

# Distances from the base station; the constants were fitted at 30 m.
USUAL_DISTANCE_M: Final = (20.0, 40.0)
# Largest share of tracks with the largest error; 13 % where the constants were fitted.
USUAL_AT_CAP: Final = 0.3
_WHOLE_DETAILS: Final = ("header", "unit", "frame-clock", "crs", "doubt")
"""Repairs that a notice gives in full, instead of their number."""
# Number of people above which a notice proposes to score only some candidates.
_LARGE_GALLERY: Final = 3000
_MINUTES_FROM_S: Final = 120.0  # Longer costs are given in minutes.
_REPAIRS: Final = {
    "gap": ("gap bridged", "gaps bridged"),
    "split": ("track split at a long gap", "tracks split at a long gap"),
    "one-point": ("single sample dropped", "single samples dropped"),
    "duplicate": ("repeated row dropped", "repeated rows dropped"),
    "unsorted": ("row sorted", "rows sorted"),
    "near-duplicate": (
        "row merged with the sample just before",
        "rows merged with the sample just before",
    ),
    "same-time": (
        "row with a second place at one time (--on-duplicate)",
        "rows with a second place at one time (--on-duplicate)",
    ),
    "jump": ("track cut at a jump", "tracks cut at a jump"),
    "clock": (
        "track cut where the clock runs back",
        "tracks cut where the clock runs back",
    ),
    "id-reuse": (
        "id used again for another person",
        "ids used again for another person",
    ),
    "lost": ("box marked as lost, dropped", "boxes marked as lost, dropped"),
    "other-label": (
        "box without a pedestrian, dropped",
        "boxes without a pedestrian, dropped",
    ),
    "frozen": (
        "frozen stretch (--drop-frozen S drops it)",
        "frozen stretches (--drop-frozen S drops them)",
    ),
    "frozen-dropped": ("frozen stretch dropped", "frozen stretches dropped"),
    "overshoot": (
        "piece of a walk made straight where a spline overshoots",
        "pieces of walks made straight where a spline overshoots",
    ),
    "fast-step": ("step above 12 m/s, not cut", "steps above 12 m/s, not cut"),
    "fast-track": (
        "track with a step above 4 m/s, not cut",
        "tracks with a step above 4 m/s, not cut",
    ),
    "ignored-column": ("column not used", "columns not used"),
    "too-short": ("track too short for a scene", "tracks too short for a scene"),
}
"""Texts for repairs by kind, in order: for a single case, and for several."""


def data_notices(dataset: Mapping[str, Any]) -> list[str]:
    """Return how a recording was read, repaired and cut; `dataset` is of a manifest."""
    counts: Counter[str] = Counter()
    for repair in dataset["repairs"]:
        counts[repair["kind"]] += repair["count"]
    if dataset["tracks_used"]:  # A run without scenes says so itself.
        counts["too-short"] = dataset["too_short"] + dataset["no_future"]
    details = [
        repair["detail"]
        for repair in dataset["repairs"]
        if repair["kind"] in _WHOLE_DETAILS
    ]
    repairs = [
        counted(counts[kind], *words)
        for kind, words in _REPAIRS.items()
        if counts[kind] > 0
    ]
    texts = [*filter(None, [few_people(dataset)]), *details]
    if repairs:
        texts.append(f"{dataset['name']}: {listed(repairs)}.")
    return texts


def too_few_people(dataset: Mapping[str, Any]) -> str:
    """Return that a recording has too few people to decide anything; else empty."""
    # A run without scenes says so itself.
    if not dataset.get("would_help") or not dataset["tracks_used"]:
        return ""
    tracks = counted(dataset["tracks_used"], "usable track")
    return f"{tracks}: too few to decide anything"


def few_people(dataset: Mapping[str, Any]) -> str:
    """Return that a recording has too few people, with a way out; else empty."""
    too_few = too_few_people(dataset)
    return f"{too_few} ({dataset['would_help']})." if too_few else ""


class SlowAttack(NamedTuple):
    """A slow attack of a plan."""

    spec: str
    n_adversaries: int
    cost_s: float  # In one process; NaN if the attack does not say.


def plan_notices(plan: Plan, *, slow: Sequence[SlowAttack]) -> list[str]:
    """Return notices on the parts that a plan leaves out and on `slow` attacks."""
    from evaluation.store.describe import (  # noqa: PLC0415 - names alone need none
        describe_data,
    )
    from isac_track.datasets.registry import (  # noqa: PLC0415 - names alone need none
        KNOWN,
    )

    texts = []
    settings, dataset = plan.settings, plan.dataset
    if settings.pilot_half_width is not None:
        texts.append(
            f"Missed conflicts are wanted to ±{settings.precision:g}. A pilot of"
            f" {BLOCK_SCENES} scenes has ±{settings.pilot_half_width:.3f}."
        )
    if dataset.notice:
        texts.append(f"notice: {dataset.notice}")
    if dataset.name not in KNOWN:  # Of a known recording docs/how-to/data.md tells.
        texts += [f"notice: {text}" for text in data_notices(describe_data(plan))]
    if why := plan.axes.why_no_scenes:
        texts.append(f"notice: left out: scenes, patrols and other linkage; {why}")
    texts += [f"notice: left out: {reason}" for reason in plan.axes.skipped.values()]
    texts += _gallery_notices(plan)
    texts += [
        f"notice: the attack {attack.spec} is slow: {cost_text(attack.cost_s)} for"
        f" {counted(attack.n_adversaries, 'adversary', 'adversaries')} at"
        f" {len(plan.axes.mechanisms)} levels in one process. It runs on one release of"
        " each source track."
        for attack in slow
    ]
    return texts


def _gallery_notices(plan: Plan) -> list[str]:
    """Return which tasks have so many people that all pairs take long."""
    sizes = {
        windows.task.name: max(
            Counter(windows.gallery.search.tolist()).values(), default=0
        )
        for windows in plan.task_windows
    }
    large = [name for name, size in sizes.items() if size > _LARGE_GALLERY]
    if not large or plan.settings.stages.linkage.candidates:
        return []
    text = (
        f"notice: {listed(large)}: galleries of up to {max(sizes.values()):,} people."
        " Time and memory grow with the square. --set linkage.candidates=100 scores"
        " the likeliest 100 alone."
    )
    return [text]


def cost_text(cost_s: float) -> str:
    """Return a rounded duration: `about 25 s`, `about 3 min`; NaN is unknown."""
    if math.isnan(cost_s):
        return "an unknown time"
    if cost_s < _MINUTES_FROM_S:
        return f"about {cost_s:.0f} s"
    return f"about {cost_s / 60.0:.0f} min"


def notices(manifest: Mapping[str, Any]) -> list[str]:
    """Return what a reader of a finished run must know about it."""
    linked = (manifest.get("linkage") or {}).get("tasks", {})
    texts = [
        f"{spec} asked for {listed(asked)}, which a robot does not have by default."
        for spec, asked in manifest.get("granted", {}).items()
    ]
    texts += [
        f"{family} has no `adding` attribute, so it is judged under both adding rules."
        for family in manifest.get("without_rule", ())
    ]
    texts += [
        f"{spec} took more than a minute for a few made-up people: it may take long."
        for spec in manifest.get("untried_plugins", ())
    ]
    if dropped := manifest.get("dropped_cells"):
        texts.append(f"{counted(dropped, 'cell')} of another code version dropped.")
    if edited := manifest.get("edited_modules"):
        texts.append(
            f"{counted(len(edited), 'module was', 'modules were')} edited while the run"
            f" computed, such as {edited[0]}. So stronger adversaries did not try the"
            " levels to propose. Run it again: cells of the old code are then replaced."
        )
    if damaged := manifest.get("damaged_cells"):
        texts.append(
            f"{counted(len(damaged), 'damaged cell')} computed again, such as"
            f" {damaged[0]}."
        )
    if redraws := manifest.get("exhausted_redraws"):
        texts.append(_redraw_text(redraws))
    for seconds, horizon in manifest.get("horizons", {}).items():
        texts += _horizon_notices(seconds, horizon)
    texts += [
        f"{task}: {counts['frozen']} of {counts['people']} tracks are nearly frozen."
        for task, counts in linked.items()
        if 2 * counts.get("frozen", 0) > counts["people"]
    ]
    lost = {task: approximation(manifest, task) for task in linked}
    texts += [f"{task}: {text}" for task, text in lost.items() if text]
    texts += [
        f"The gallery of tracks lacks {reason}."
        for reason in manifest.get("gallery_without", ())
    ]
    return texts


def _horizon_notices(seconds: Any, horizon: Mapping[str, Any]) -> list[str]:  # noqa: ANN401 - a key of JSON
    """Return notices on the people and conflicts that a further horizon leaves out."""
    texts = []
    if not horizon["tracks_used"]:
        texts.append(
            f"No conflicts {seconds} s ahead: too few recordings last so long after the"
            " history."
        )
    elif horizon["no_future"]:
        tracks = counted(horizon["no_future"], "track ends", "tracks end")
        texts.append(
            f"{seconds} s ahead: {tracks} before that and cannot be used there."
        )
    if redraws := horizon.get("exhausted_redraws"):
        texts.append(f"{seconds} s ahead: {_redraw_text(redraws)}")
    return texts


def _redraw_text(n: int) -> str:
    agents = counted(n, "background agent keeps its", "background agents keep their")
    return f"{agents} last draw, since no place with scenes.clearance_m was free."


def used_are_slower(manifest: Mapping[str, Any], *, least: float = 0.0) -> str:
    """Compare the mean speed of the used tracks with that of all tracks.

    The text is empty if they differ by less than `least`, a share of the mean speed of
    all tracks.
    """
    speeds = manifest["dataset"].get("speed_mps")
    if not speeds:
        return ""
    difference = abs(speeds["used"] - speeds["recorded"])
    if not difference > least * speeds["recorded"]:
        return ""
    min_s = manifest["settings"]["stages"]["resample.min_duration_s"]
    slower = "slower" if speeds["used"] < speeds["recorded"] else "faster"
    return (
        f"tracks of at least {min_s:g} s are {slower} than all: {speeds['used']:.2f}"
        f" m/s against {speeds['recorded']:.2f} m/s on average"
    )


def unusual_geometry(manifest: Mapping[str, Any]) -> list[str]:
    """Return a line if distances or errors of people are unusual, else none."""
    known = manifest.get("geometry")
    if not known:
        return []
    low_m, high_m = USUAL_DISTANCE_M
    is_far = not low_m <= known["distance_m"] <= high_m
    if not is_far and known["at_cap"] <= USUAL_AT_CAP:
        return []
    usual = f"usual: {low_m:.0f} to {high_m:.0f} m" if is_far else "median"
    text = (
        f"Geometry: people are {known['distance_m']:.4g} m from the station ({usual})"
    )
    if known["at_cap"] > USUAL_AT_CAP:
        text += f"; {whole_percent(known['at_cap'])} have the largest error"
    return [f"{text}."]


def geometry(manifest: Mapping[str, Any]) -> list[str]:
    """Return the distances from the base station in a line; none if unknown."""
    known = manifest.get("geometry")
    if not known:
        return []
    stages = manifest["settings"]["stages"]
    low_m, high_m = USUAL_DISTANCE_M
    is_far = not low_m <= known["distance_m"] <= high_m
    usual_m = f" (usual: {low_m:.0f} to {high_m:.0f} m)" if is_far else ""
    is_capped = known["at_cap"] > USUAL_AT_CAP
    usual_share = f" (usual: up to {whole_percent(USUAL_AT_CAP)})" if is_capped else ""
    text = (
        "Geometry: the median distance to the base station is"
        f" {known['distance_m']:.0f} m{usual_m}; the median raw error is"
        f" {known['sigma_raw_m']:.2f} m. {whole_percent(known['at_cap'])} of tracks have"
        f" the largest error, {stages['sensing.sigma_cap_m']:g} m{usual_share}."
    )
    if is_far and stages["sensing.place"] == "file":
        text += (
            " The coordinates are those of the file (sensing.place=file). --set"
            " sensing.bs_x_m and bs_y_m move the station; sensing.place=centred moves"
            " the recording."
        )
    return [text]


def linked_people(manifest: Mapping[str, Any]) -> list[str]:
    """Return a line on the number of people in each task, and why others are out."""
    texts = []
    for name, counts in ((manifest.get("linkage") or {}).get("tasks", {})).items():
        reasons = []
        if counts.get("too_short"):
            reasons.append(f"{counts['too_short']:,} not there for long enough")
        if counts.get("not_drawn"):
            reasons.append(f"{counts['not_drawn']:,} beyond linkage.most_people")
        others = f" ({listed(reasons)})" if reasons else ""
        texts.append(f"{name} {counts['people']:,}{others}")
    return [f"people in linkage tasks: {'; '.join(texts)}"] if texts else []


def approximation(manifest: Mapping[str, Any], task: str) -> str:
    """Return the cost of `linkage.candidates` to a task; empty if it had none."""
    lost = (manifest.get("linkage") or {}).get("candidates", {}).get(task)
    if not lost:
        return ""
    per_probe = manifest["settings"]["stages"]["linkage.candidates"]
    linker = parse_label(lost["consumer"]).without_task.label
    mean, most = (round(PERCENT * lost[name], 1) + 0.0 for name in ("loss", "most"))
    return (
        f"Linkers scored {per_probe} candidates of each probe. That cost {mean:.1f}"
        f" points of rank 1 on average, and at most {most:.1f} ({linker} at"
        f" {lost['spec']}). {lost['probes']} probes in each of {lost['cells']} cells"
        " were searched in full, too. Metrics of all pairs are refused."
    )
