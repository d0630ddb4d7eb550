"""Equilibria: rootfinding, the branch that slow loading reaches, boundary conditions at the tip, inverse statics."""
