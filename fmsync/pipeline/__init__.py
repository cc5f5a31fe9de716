"""From mesh files to correspondences with a confidence on every vertex."""

from fmsync.pipeline.confidence import Confidence
from fmsync.pipeline.recalibration import Recalibration, fit_recalibration
from fmsync.pipeline.synchronise import SyncedShapes, synchronize_shapes

__all__ = ["Confidence", "Recalibration", "SyncedShapes", "fit_recalibration", "synchronize_shapes"]
