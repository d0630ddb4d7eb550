"""The Koopman generator of the known part f (gEDMD) and its half-step map K_f.

Generator from Jacobians of the observables, its exponential or the flow map over dt/2, and the spectrum that chooses
between them.
"""

from pisplit.generator.generator import KnownOptions, generator_edmd, weighted_moments
from pisplit.generator.half_step import HALF_STEPS, HalfStep, equilibrium_drift, flow_map, half_step
from pisplit.generator.spectrum import Spectrum, generator_spectrum, spectral_radius, spectrum

__all__ = [
    "HALF_STEPS",
    "HalfStep",
    "KnownOptions",
    "Spectrum",
    "equilibrium_drift",
    "flow_map",
    "generator_edmd",
    "generator_spectrum",
    "half_step",
    "spectral_radius",
    "spectrum",
    "weighted_moments",
]
