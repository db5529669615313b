"""What all environments build on: tasks, arms, random streams, spaces and the simulated step."""
