"""Where to measure, and in which order."""
