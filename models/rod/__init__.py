"""Cosserat-rod scenes in CasADi."""
