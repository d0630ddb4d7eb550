"""Balance of forces and moments (paper, eq. cosserat_rod_eq) as symbolic residuals, direct and variational."""
