"""How good a calibration is: error statistics, states of parameters, grades, intervals."""
