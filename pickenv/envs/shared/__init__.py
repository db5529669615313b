"""Code that all environments share: tasks, arms, random streams, spaces and the simulated step."""
