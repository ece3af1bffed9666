"""Follow people through the log of a fleet of robots, which holds no identities.

`pieces` joins answers that repeat a sample, `links` estimates how likely a piece goes
on as another, `absence` counts evidence from silence, `chains` joins pieces, `logs`
follows all people, `followed` scores the result. docs/explanation/need-to-know.md
explains the adversary.
"""
