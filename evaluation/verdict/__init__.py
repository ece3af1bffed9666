"""The decisions of a run, as data: from estimates to answers.

The main question: do the descriptors PLR, AEL and MEL say how likely a person is linked
from one release to another? docs/explanation/verdict.md has the question, the rules and
their reasons. docs/reference/glossary.md has the terms of the field.

Each section of the verdict tests one thing:

Validity
    At the same descriptor value, do all mechanisms let as many people be linked?
Within
    At one level, does a track's own descriptor tell whether the track is linked?
Claim
    At equal missed conflicts, is FID lower than fixed noise (the paper's claim)?
Inflation
    Is a descriptor higher after the strongest attack than on the positions as shared?

The nouns and decisions:

Draft
    An effect with bootstrap replicates, and the meaning of its two sides, before any
    decision. Drafts of a section are decided together (`bands.Draft`,
    `validity_drafts.ValidityDraft`).
Item
    A draft with its decision, interval and sentence, such as the validity of PLR in a
    task (`items`). Its `Topic` says what it is about.
Contrast
    Linkage under a mechanism level less that under fixed noise at the same descriptor
    value. The *spread* is the largest contrast of a panel; it decides validity.
Panel
    The mechanisms that validity compares, fixed by the preset (`panel`).
Decision
    *tracks* or *does not track*; in claims *holds* or *reversed*; in inflation *inflated*
    or *deflated*. *Between*: the interval has both answers. *Not testable*: the run
    cannot tell, and `why` says the reason. Neither says that there is no effect.

The statistics: effects are resampled by *cluster* (a person, or a group who walk
together). Few *effective* clusters mean no decision (`isac_track.intervals`). The items
of a section share simultaneous bands by max-t (`bands`), which allow for their number.
Validity has an interval of its own (`spread`). All margins are in `rules`.

Read in this order:

1. `rules`, `items`: margins, names of decisions, records.
2. `bands`, then its users `inflation`, `claim` and `within_level`: the shorter path.
3. `panel`, `curves`, `contrasts`, `spread`, `power`, then `validity_drafts`, `validity`
   and `validity_words`. `prediction_error` stands beside and decides nothing.
4. `sections` puts all together; `verdict_json` alone knows the keys of these items.

Three other answers stand by themselves:

- Levels that a site may share: `question`, `level_rows`, `offers`, `level_checks`,
  `what_to_share`.
- Policies for robots on patrol: `patrol_records`, `patrols`, `patrol_json`.
- People who come back, and whether a walk identifies them: `returns`.

`sensitivity` compares the verdicts of runs under other assumptions. `number_text` writes
numbers into sentences.
"""
