"""The part of `evaluation.design` that is about patrols: policy and mechanism."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from evaluation.estimates.families import Family
from evaluation.reporting import table as make
from evaluation.reporting.amounts import listed
from evaluation.reporting.patrol_words import (
    lacking_text,
    proposal_sentence,
    shared_name,
)
from evaluation.reporting.table import Table
from evaluation.verdict.patrol_json import option_json, proposal_json, read_options
from evaluation.verdict.patrol_records import (
    PatrolLimits,
    PatrolOption,
    PatrolProposal,
)
from evaluation.verdict.patrols import choose_policy

_COLUMNS: Final = {
    "missed": "missed at equal alarms",
    "lost": "above raw",
    "known": "known",
    "followed": "followed 10 s",
}
"""Heads of the table, by the names of an option's shares."""


@dataclass(frozen=True, slots=True)
class PatrolAnswer:
    """The answer about patrols, of a run and its limits."""

    text: str
    proposal: PatrolProposal | None  # None: the run cannot say.
    options: Sequence[PatrolOption]  # Of the robot and the horizon of the proposal.
    # Whether a limit was asked that only patrols can hold.
    is_asked: bool

    @property
    def met(self) -> bool:
        """Whether a policy holds all limits, with intervals."""
        proposal = self.proposal
        return proposal is not None and proposal.is_within and proposal.has_interval

    def to_json(self) -> dict[str, Any]:
        """Return plain values; without patrols the answer alone."""
        return {"met": self.met, "answer": self.text, **proposal_json(self.proposal)}


def answer_on_patrol(
    patrols: Mapping[str, Any],
    limits: PatrolLimits,
    *,
    robot: str,
    horizon_s: float | None,
    families: Mapping[str, Family],
) -> PatrolAnswer:
    """Return the policy and mechanism for patrols, or why the run cannot say.

    `patrols` is that of `verdict.json`, empty without patrols.
    """
    is_asked = limits.known is not None or limits.followed is not None
    options = read_options(patrols)
    proposal = choose_policy(options, limits, horizon_s=horizon_s, robot=robot)
    if proposal is None:
        lacking = lacking_text(patrols)
        if options:
            lacking = _missing_option(options, robot=robot, horizon_s=horizon_s)
        return PatrolAnswer(f"On patrol: {lacking}", None, (), is_asked)
    own = [
        option
        for option in options
        if (option.robot, option.horizon_s) == (proposal.robot, horizon_s)
    ]
    text = f"On patrol: {proposal_sentence(proposal, families=families)}"
    if not proposal.has_interval:
        text += " Without intervals no limit holds: add --set patrol.fleets=20."
    return PatrolAnswer(text, proposal, own, is_asked)


def _missing_option(
    options: Sequence[PatrolOption], *, robot: str, horizon_s: float | None
) -> str:
    """Return why the options of a run have none for a robot at a horizon."""
    judged = [option for option in options if option.horizon_s == horizon_s]
    if not judged:
        name = "the run's own horizon" if horizon_s is None else f"{horizon_s:g} s"
        add = (
            ""
            if horizon_s is None
            else f"; add --set conflict.horizons_s={horizon_s:g}"
        )
        return f"no conflicts within {name} were judged{add}."
    robots = listed([*dict.fromkeys(option.robot for option in judged)])
    return f"{robot} does not patrol; the robots of patrols are {robots}."


def patrol_table(
    options: Sequence[PatrolOption], families: Mapping[str, Family]
) -> Table:
    """Return the options of a robot at a horizon, in the order of what is known."""
    columns = [
        make.text_column("policy"),
        make.text_column("mechanism"),
        *(
            make.share_column(head, name, f"{name}_low", f"{name}_high")
            for name, head in _COLUMNS.items()
        ),
    ]
    ordered = sorted(options, key=lambda option: option.known.value)
    records = [
        option_json(option)
        | {"mechanism": shared_name(option.mechanism, option.level, families)}
        for option in ordered
    ]
    return make.build_table("patrols", "On patrol", records, columns, n_keys=2)
