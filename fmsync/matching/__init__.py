"""From mesh files to correspondences with a confidence on every vertex; needs the extra ``shapes``."""

from fmsync.extras import require_all

require_all(__name__, "shapes", "joblib", "pandas", "potpourri3d", "pyvista", "robust_laplacian")

from fmsync.matching.add import add_shape  # noqa: E402
from fmsync.matching.confidence import Confidence  # noqa: E402
from fmsync.matching.conformal import ConformalCalibration, fit_conformal  # noqa: E402
from fmsync.matching.output import load_synced  # noqa: E402
from fmsync.matching.synchronize import SyncedShapes, synchronize_matches, synchronize_shapes  # noqa: E402
from fmsync.matching.transferred import transfer, transfer_landmarks  # noqa: E402

__all__ = [
    "Confidence",
    "ConformalCalibration",
    "SyncedShapes",
    "add_shape",
    "fit_conformal",
    "load_synced",
    "synchronize_matches",
    "synchronize_shapes",
    "transfer",
    "transfer_landmarks",
]
