"""Equilibria: rootfinding with fallbacks, load continuation, boundary conditions at the tip, inverse statics."""
