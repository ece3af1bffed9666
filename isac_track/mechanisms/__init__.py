"""Mechanisms: how a network shares its sensed positions.

`paper` has those of the paper, `protections`, `stationary`, `shaped` and `literature`
errors of further kinds, `withholding` fewer samples, and `controls` no protection.
`perturb` adds errors by the error law and the adding rule; `error_paths` draws slow
errors.
"""
