"""Export of a calibration to files that robots, controllers, simulators and other programs read."""
