"""Disclosure policies: the choice of samples and people in an answer to a robot.

A mechanism changes samples; a policy chooses among them. `query` holds the input of a
policy, `samples` the policies that send samples, `summaries` those that send a state or
a flag.
"""
