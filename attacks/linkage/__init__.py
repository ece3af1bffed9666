"""Linkage attacks: whose release is it? Tasks, and one attack a file."""
