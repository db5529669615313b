"""The quality of a calibration: error statistics, states of parameters, grades, intervals."""
