"""Following people through the log of a fleet of robots, which holds no identities.

`pieces` joins answers that repeat a sample, `links` says how likely one piece goes on
as another, `absence` what it tells that nothing was sent, `chains` joins pieces,
`followed` scores them. docs/need-to-know.md explains the adversary.
"""
