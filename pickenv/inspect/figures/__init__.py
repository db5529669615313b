"""Figures for papers and reports."""

from pickenv.extras import require as _require

_require("matplotlib")
