"""Policies on seeded fruit, compared over arms and seeds."""
