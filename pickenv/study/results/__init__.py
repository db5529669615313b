"""Rows of a study and what is computed from them in one pass."""

from pickenv.extras import require as _require

_require("pyarrow", "joblib")
