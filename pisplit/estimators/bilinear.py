"""Extended dynamic mode decomposition with control, bilinear in lifted state and input."""

from __future__ import annotations

from pisplit.data.episodes import Episodes
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.edmdc import DirectEDMDc


class BilinearEDMDc(DirectEDMDc):
    """B-EDMDc: z+ = A z + B phi(u) + sum_i u_i N_i z (paper, bilinear dictionary after eq. l_edmdc_dict).

    Bruder, Fu and Vasudevan, IEEE Robotics and Automation Letters 6, 2021.

    The dictionary is that of LinearEDMDc; products of the inputs with all its lifted columns are added, or with those
    that its ``ob.Bilinear(columns)`` names. With states and the constant alone it is the paper's
    Theta = [Theta_x; u_1 Theta_x; ..; u_m Theta_x]. Options: :class:`pisplit.estimators.edmdc.DirectEDMDc`.
    """

    def _dictionary(self, d1: Episodes) -> Dictionary:
        theta = self.theta.named_after(d1)
        return theta if theta.is_bilinear else theta.bilinear()
