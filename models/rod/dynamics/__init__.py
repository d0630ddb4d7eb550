"""Motion: IDAS on the implicit equations, fixed-step Gauss collocation, trajectories."""
