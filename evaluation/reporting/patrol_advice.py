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
from evaluation.verdict.patrols import (
    Option,
    PatrolLimits,
    Proposal,
    choose_policy,
)

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
    proposal: Proposal  # Empty: the run cannot say.
    options: Sequence[Option]  # Of the robot and the horizon of the proposal.
    # Whether a limit was asked that only patrols can hold.
    is_asked: bool

    @property
    def met(self) -> bool:
        """Whether a policy holds all limits, with intervals."""
        return bool(self.proposal.get("best")) and self.proposal["has_interval"]

    def to_json(self) -> dict[str, Any]:
        """Return plain values; without patrols the answer alone."""
        return {"met": self.met, "answer": self.text, **self.proposal}


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
    options = patrols.get("options", ())
    proposal = choose_policy(options, limits, horizon_s=horizon_s, robot=robot)
    if not proposal:
        lacking = _lacking(patrols, robot=robot, horizon_s=horizon_s)
        return PatrolAnswer(f"On patrol: {lacking}", {}, (), is_asked)
    own = [
        option
        for option in options
        if (option["robot"], option["horizon_s"]) == (proposal["robot"], horizon_s)
    ]
    text = f"On patrol: {proposal_sentence(proposal, families=families)}"
    if not proposal["has_interval"]:
        text += " Without intervals no limit holds: add --set patrol.fleets=20."
    return PatrolAnswer(text, proposal, own, is_asked)


def _lacking(patrols: Mapping[str, Any], *, robot: str, horizon_s: float | None) -> str:
    """Return what a run lacks for a proposal on patrols."""
    options = patrols.get("options", ())
    if not options:
        return lacking_text(patrols)
    judged = [option for option in options if option["horizon_s"] == horizon_s]
    if not judged:
        name = "the run's own horizon" if horizon_s is None else f"{horizon_s:g} s"
        add = (
            ""
            if horizon_s is None
            else f"; add --set conflict.horizons_s={horizon_s:g}"
        )
        return f"no conflicts within {name} were judged{add}."
    robots = listed([*dict.fromkeys(str(option["robot"]) for option in judged)])
    return f"{robot} does not patrol; the robots of patrols are {robots}."


def patrol_table(options: Sequence[Option], families: Mapping[str, Family]) -> Table:
    """Return the options of a robot at a horizon, in the order of what is known."""
    columns = [
        make.text_column("policy", lambda option: option["policy"]),
        make.text_column("mechanism", lambda option: shared_name(option, families)),
        *(
            make.share_column(head, name, f"{name}_low", f"{name}_high")
            for name, head in _COLUMNS.items()
        ),
    ]
    ordered = sorted(options, key=lambda option: option["known"])
    return make.build_table("patrols", "On patrol", ordered, columns, n_keys=2)
