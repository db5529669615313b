"""Rows of a study and what is computed from them in one pass."""
