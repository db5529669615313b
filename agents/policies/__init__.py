"""Policies: scripted, servoed, adaptive, learned."""
