"""Planning of measurements: which poses to measure, and in which order."""
