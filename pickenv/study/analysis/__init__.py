"""What a study says: sensitivities, figures, report, recording."""

from pickenv.extras import require as _require

_require("pyarrow", "joblib")
