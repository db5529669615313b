"""Chunks of arms, computed by one process or many."""
