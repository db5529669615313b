"""Run folders, and the numbers that pictures start from."""
