"""Causes that make an arm miss, as effects of one protocol."""
