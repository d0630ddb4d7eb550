"""Observables: the building blocks of a :class:`pisplit.Dictionary` (``from pisplit import observables as ob``).

Every observable writes its columns for given symbols. A column belongs to the *state part* psi (functions of x_k) or to
the *input part* phi (functions of u_k); :class:`Delays` adds past values of both, :class:`Bilinear` products of inputs
with lifted columns. Observables add (``a + b``: the columns of both), multiply (``a * b``: products of their columns)
and compose (``compose(f, g)``: f of the columns of g).
"""

from pisplit.observables.algebra import Composition, Product, Sum, compose
from pisplit.observables.basic import Bilinear, Constant, Delays, Identity, Inputs, States
from pisplit.observables.columns import Columns, Names, Observable
from pisplit.observables.expressions import CoordinateSource, Equilibrium, Expression, RodCoordinates, StateMap
from pisplit.observables.fourier import Fourier, RandomFourier
from pisplit.observables.hinges import Hinge, Slack
from pisplit.observables.polynomials import Polynomials
from pisplit.observables.principal import Principal
from pisplit.observables.radial import Radial
from pisplit.observables.slip import Slip
from pisplit.observables.tension import Tension

__all__ = [
    "Bilinear",
    "Columns",
    "Composition",
    "Constant",
    "CoordinateSource",
    "Delays",
    "Equilibrium",
    "Expression",
    "Fourier",
    "Hinge",
    "Identity",
    "Inputs",
    "Names",
    "Observable",
    "Polynomials",
    "Principal",
    "Product",
    "Radial",
    "RandomFourier",
    "RodCoordinates",
    "Slack",
    "Slip",
    "StateMap",
    "States",
    "Sum",
    "Tension",
    "compose",
]
