"""The ground of all environments: tasks, arms, random streams, spaces, the simulated step."""
