"""Assessment of a calibration's quality: error statistics with intervals, statistical tests, grades, and tables."""
