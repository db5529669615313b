"""What all environments stand on: tasks, arms, random streams, spaces, the simulated step."""
