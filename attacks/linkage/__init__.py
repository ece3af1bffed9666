"""Linkage attacks: whose release is it? One attack a file."""
