"""The calibration pipeline: from measured rows to a result, and the use of the result."""
