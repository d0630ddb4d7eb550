"""L-EDMDc, B-EDMDc, PI-EDMDc, twins, re-lifted and streaming fits: estimators that turn data into a lifted model.

The search over alpha and the tests of boundedness stand beside them.
"""

from pisplit.estimators.bilinear import BilinearEDMDc
from pisplit.estimators.edmdc import LinearEDMDc
from pisplit.estimators.pi import PIEDMDc
from pisplit.estimators.relifted import ReliftedEDMDc
from pisplit.estimators.streaming import StreamingEDMDc
from pisplit.estimators.twin import TwinEDMDc

__all__ = [
    "BilinearEDMDc",
    "LinearEDMDc",
    "PIEDMDc",
    "ReliftedEDMDc",
    "StreamingEDMDc",
    "TwinEDMDc",
]
