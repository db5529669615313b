"""The orchard: fruit and canopy, what cameras see of it, what grippers forgive, and how fruit swings and comes off."""

from pickenv.base.faces import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.orchard", __file__)
