"""Mechanisms: what a network shares of what it senses. One file a kind."""
