"""The multi-arm harvester of Li 2016: machine, pick points, zones, assignment, interference, and picking with it."""

from pickenv.base.extras import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.harvester", __file__)
