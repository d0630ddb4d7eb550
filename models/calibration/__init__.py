"""Numbers of a real arm: from shapes at rest, from pairs, from noisy recordings of markers."""
