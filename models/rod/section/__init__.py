"""What the rod is made of: cross-sections, materials, and the body that joins them along the arclength."""
