"""Handing a calibration over: files that robots, controllers, simulators and other programs read."""
