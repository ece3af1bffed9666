"""Adversaries who estimate where people truly were."""
