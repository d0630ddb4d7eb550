"""The Koopman generator of the known part f (gEDMD) and its half-step map K_f.

Generator from Jacobians of the observables, its exponential or the flow map over dt/2, and the spectrum that chooses
between them.
"""

from pisplit.generator.generator import (
    HALF_STEPS,
    HalfStep,
    equilibrium_drift,
    flow_map,
    generator_edmd,
    generator_spectrum,
    half_step,
    spectral_radius,
)
from pisplit.generator.spectrum import Spectrum, spectrum

__all__ = [
    "HALF_STEPS",
    "HalfStep",
    "Spectrum",
    "equilibrium_drift",
    "flow_map",
    "generator_edmd",
    "generator_spectrum",
    "half_step",
    "spectral_radius",
    "spectrum",
]
