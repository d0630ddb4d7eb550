"""Shape of the rod from its strains: Gauss nodes, rotations, strain sets, positions and velocities, coordinates."""
