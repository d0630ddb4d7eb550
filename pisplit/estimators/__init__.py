"""L-EDMDc, B-EDMDc, PI-EDMDc, twins and streaming fits: estimators that turn data into a lifted model.

The search over alpha and the tests of boundedness stand beside them.
"""

from pisplit.estimators.bilinear import BilinearEDMDc
from pisplit.estimators.edmdc import LinearEDMDc
from pisplit.estimators.pi import PIEDMDc
from pisplit.estimators.streaming import StreamingEDMDc
from pisplit.estimators.twin import TwinEDMDc

__all__ = [
    "BilinearEDMDc",
    "LinearEDMDc",
    "PIEDMDc",
    "StreamingEDMDc",
    "TwinEDMDc",
]
