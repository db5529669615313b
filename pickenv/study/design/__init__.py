"""What a study draws: its configuration, deviations and shared protocol."""
