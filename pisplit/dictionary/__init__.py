"""Theta(x, u): observables in one order, with names, quantities and derivatives, compiled for many samples at once.

The columns are evaluated, propagated by chain rule, inverted to the state, saved and loaded.
"""

from pisplit.dictionary.compiled import Part, compile_part
from pisplit.dictionary.dictionary import Dictionary
from pisplit.dictionary.products import BilinearTerm, Transition

__all__ = [
    "BilinearTerm",
    "Dictionary",
    "Part",
    "Transition",
    "compile_part",
]
