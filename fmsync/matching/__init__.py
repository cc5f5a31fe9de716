"""From mesh files to correspondences with a confidence on every vertex; needs the extra ``shapes``."""

from fmsync.extras import require_all

require_all(__name__, "shapes", "joblib", "pandas", "potpourri3d", "pyvista", "robust_laplacian")

from fmsync.matching.add import add_shape as add_shape  # noqa: E402
from fmsync.matching.confidence import Confidence as Confidence  # noqa: E402
from fmsync.matching.conformal import ConformalCalibration as ConformalCalibration  # noqa: E402
from fmsync.matching.conformal import fit_conformal as fit_conformal  # noqa: E402
from fmsync.matching.output import load_synced as load_synced  # noqa: E402
from fmsync.matching.synchronize import SyncedShapes as SyncedShapes  # noqa: E402
from fmsync.matching.synchronize import synchronize_matches as synchronize_matches  # noqa: E402
from fmsync.matching.synchronize import synchronize_shapes as synchronize_shapes  # noqa: E402
from fmsync.matching.transferred import transfer as transfer  # noqa: E402
from fmsync.matching.transferred import transfer_landmarks as transfer_landmarks  # noqa: E402
