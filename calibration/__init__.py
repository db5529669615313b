"""Calibration of robot arms: identify an arm's parameters from measurements, judge the result, and correct commands.

`calibrate` does all steps, from files or arrays to a `Result`. A residual model can learn the errors that the
parameters leave. The package works without Gymnasium and imports only `pickenv.arm`. torch is loaded only when a
network is trained.
"""

from pickenv.base.extras import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.calibration", __file__)

if __name__ == "calibration":  # in a checkout, by the folder's own name: the same things, and no second copy of a shelf
    __path__.clear()
