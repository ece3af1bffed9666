"""Disclosure policies: which samples of which people the answer to a robot holds.

A mechanism changes samples; a policy chooses among them. `query` has what a policy
sees, `samples` the policies that send samples, `summaries` those that send less than a
sample.
"""
