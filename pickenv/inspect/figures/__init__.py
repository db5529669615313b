"""Figures for papers and reports."""

from pickenv.base import require as _require

_require("matplotlib")
