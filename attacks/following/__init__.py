"""Follow people through the log of a fleet of robots, which holds no identities.

`pieces` joins answers that repeat a sample, `links` estimates how likely a piece goes
on as another, `absence` counts evidence from silence, `chains` joins pieces, `logs`
follows all people, `followed` scores the result. docs/explanation/need-to-know.md
explains the adversary.

`posterior` states a density at every instant, from the `experts` that `pool` weighs; one
of them is a `walk_chain`, with `answer_evidence`. `probing` asks about invented routes,
and holds a `belief`. `posterior_metrics` scores the first; the second scores itself.
"""
