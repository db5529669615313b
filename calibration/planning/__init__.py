"""Poses to measure, and their order."""
