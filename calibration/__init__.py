"""Calibration: identify an arm from measurements, learn what remains, judge it, and correct its commands.

`calibrate` is the whole way, from files or arrays to a `Result`. Usable without Gymnasium; imports only `pickenv.arm`.
torch is loaded when a network is trained, not before.
"""

from pickenv.base.faces import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.calibration", __file__)

if __name__ == "calibration":  # in a checkout, by the folder's own name: the same things, and no second copy of a shelf
    __path__.clear()
