"""What acts on a rod, one file a term: gravity, drag, damping, tendons, chambers, loads, masses, springs, bases."""
