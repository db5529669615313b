"""The ground that every room stands on: errors, files, containers, TOML tables, intervals, seeds, the registry."""

from pickenv.base.faces import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.base", __file__)
