"""The orchard: fruit and canopy, how cameras see fruit, what misalignment grippers tolerate, and how fruit detaches."""

from pickenv.base.extras import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.orchard", __file__)
