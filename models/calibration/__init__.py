"""Calibration: an arm identified from measured equilibria, shapes, pairs or recordings; the result is an arm again."""

from pisplit.models.calibration.choice import CalibrationChoice, TriedCalibration
from pisplit.models.calibration.choosing import choose_calibration
from pisplit.models.calibration.estimates import Estimate
from pisplit.models.calibration.fit import calibrate_from_equilibria, calibrate_from_pairs, calibrate_from_shapes
from pisplit.models.calibration.from_markers import calibrate_from_markers
from pisplit.models.calibration.model import Calibration, CalibrationError, nominal_parameters
from pisplit.models.calibration.parameters import TendonParameters
from pisplit.models.calibration.parametrised import CalibratedTendons
from pisplit.models.calibration.recordings import calibrate_from_recordings
from pisplit.models.calibration.ring_down import FoundDamping, calibrate_damping

__all__ = [
    "CalibratedTendons",
    "Calibration",
    "CalibrationChoice",
    "CalibrationError",
    "Estimate",
    "FoundDamping",
    "TendonParameters",
    "TriedCalibration",
    "calibrate_damping",
    "calibrate_from_equilibria",
    "calibrate_from_markers",
    "calibrate_from_pairs",
    "calibrate_from_recordings",
    "calibrate_from_shapes",
    "choose_calibration",
    "nominal_parameters",
]
