"""Evaluation of policies on seeded fruit, compared over arms and seeds."""
