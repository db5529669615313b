"""What calibrations leave of measured robots, beside what was predicted and what others reach: `pickenv bench`."""
